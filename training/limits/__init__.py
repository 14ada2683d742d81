"""Decision limits, their calibration, decision rules of the literature, and the data check."""
