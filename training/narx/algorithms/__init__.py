"""Training algorithms of the network."""
