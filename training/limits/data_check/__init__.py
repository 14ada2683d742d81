"""Is the data enough? Said before any training."""
