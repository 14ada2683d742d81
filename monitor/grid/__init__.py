"""Step 3: values become samples on a fixed grid of time."""
