"""A simulated vehicle on a chassis dynamometer; all its signals are synthetic."""
