"""Decisions of a driving cycle from windows and single results; rules of plug-ins."""
