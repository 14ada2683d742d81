"""OBD-II parameters as an input: asked for where a vehicle broadcasts nothing useful."""
