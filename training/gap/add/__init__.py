"""What was named becomes part of the model's graph."""
