"""The connection to a CAN bus: opening, receiving, reconnecting, recording."""
