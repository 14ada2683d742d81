"""The doctor of a bench: the interface, and what is wrong with the bus behind it."""
