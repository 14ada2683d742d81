"""Estimates of a window in which nothing was seen."""

from monitor.judge.response.estimates import Estimates, WindowEstimates

NO_ESTIMATES = WindowEstimates(Estimates(0.0, 0.0, "healthy"), 0.0, None, None, 0.0, 0.0)
