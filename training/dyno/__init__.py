"""A simulated vehicle on a chassis dynamometer; every number it makes is synthetic."""
