"""Shared by every room: types, errors, configuration, signal and fault names, output files."""
