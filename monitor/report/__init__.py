"""Checks of logs, and results as lines of text and HTML pages."""
