"""Decision limits, calibration, rules of the literature, data check, and targets."""
