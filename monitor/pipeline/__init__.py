"""Steps 2 to 9 as one object without I/O, for a stream and for whole recordings."""
