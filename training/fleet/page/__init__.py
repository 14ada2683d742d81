"""The report of a fleet: outliers, proposed limits, figures, page."""
