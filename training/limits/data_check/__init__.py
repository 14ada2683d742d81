"""Checks before training whether recordings are enough for a model."""
