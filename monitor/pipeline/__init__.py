"""Steps 2 to 9 without I/O, for a live bus and for whole recordings."""
