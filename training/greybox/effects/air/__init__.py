"""Effects on the air that the cylinder gets."""
