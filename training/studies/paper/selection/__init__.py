"""Input selection: principal components, free runs of input sets, transparency."""
