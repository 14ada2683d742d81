"""Limits of the response rule, learned from healthy recordings."""
