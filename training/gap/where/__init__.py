"""Where model and vehicle disagree."""
