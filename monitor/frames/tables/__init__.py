"""Logs of tuning tools as raw tables: one file per format, columns as the logger wrote them."""
