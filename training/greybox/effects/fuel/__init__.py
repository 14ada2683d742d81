"""Effects on the fuel that the cylinder gets."""
