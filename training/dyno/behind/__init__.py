"""Catalyst, downstream sensor and tailpipe of the simulated car."""
