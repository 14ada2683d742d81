"""Part 2 of the study, input selection: principal components, input sets, transparency."""
