"""Steps 4 and 6 to 8: enable conditions, residuals, windows and the decision rules."""
