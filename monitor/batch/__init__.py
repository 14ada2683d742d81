"""Whole recordings at once, with the same results as the streaming pipeline."""
