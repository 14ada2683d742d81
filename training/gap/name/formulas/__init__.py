"""Formulas of recorded signals, for effects that no library has."""
