"""What an output without a chain does differently from the healthy vehicle, calibrated by runs."""
