"""Decisions of a driving cycle from windows, fuel cuts and single results; rules of plug-ins."""
