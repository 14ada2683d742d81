"""From recordings to samples that train a model."""
