"""Preparation: outliers, spectra and noise lines."""
