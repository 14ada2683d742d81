"""Decision rules of the literature, for comparison with the rules of the monitor."""
