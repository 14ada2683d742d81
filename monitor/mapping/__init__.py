"""Proposes a signal map for a CAN database, for a person to confirm."""
