"""The training algorithm of the network, and the error that it minimises."""
