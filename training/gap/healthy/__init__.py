"""The behaviour of the base on healthy drives."""
