"""Diagnostics on ISO-TP: OBD services and UDS, answered from the fault memory."""
