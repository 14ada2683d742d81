"""What the recordings of a healthy vehicle say, and what of it a new model's card keeps."""
