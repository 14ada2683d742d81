"""Decision limits, their calibration, the evaluation of a model, and the data check."""
