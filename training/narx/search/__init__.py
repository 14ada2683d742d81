"""The search for a network: structures, starts, stages of one training."""
