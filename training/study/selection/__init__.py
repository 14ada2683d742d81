"""Input selection: principal components, input sets in free run, transparency."""
