"""Fuel cuts, and the test of the fuel-cut response."""
