"""Judge before a training whether recordings suffice to train a model."""
