"""Figures of the study, one module per section of its page."""
