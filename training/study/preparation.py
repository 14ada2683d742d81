"""Part 1 of the study: outliers, spectrum, noise lines, and what linear baselines are given."""

from training.study.linear_data import LinearData, linear_records

__all__ = ["LinearData", "linear_records"]
