"""The charge: a map of the volumetric efficiency, and the error of the air meter."""
