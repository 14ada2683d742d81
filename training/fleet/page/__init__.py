"""The report of a fleet: outliers, limits, figures, page."""
