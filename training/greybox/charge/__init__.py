"""The charge of the chain: its own map of efficiency, or the error of the broadcast charge."""
