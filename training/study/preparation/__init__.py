"""Part 1 of the study, preparation: outliers, spectra and noise lines."""
