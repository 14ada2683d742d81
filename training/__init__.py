"""Offline part: recordings, the simulated dynamometer, the NARX and its training."""
