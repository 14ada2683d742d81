"""CAN databases and the signal maps that lie beside them."""
