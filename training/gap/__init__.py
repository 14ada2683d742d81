"""The gap workflow: the effect of a healthy vehicle that a model lacks, named, added, verified."""
