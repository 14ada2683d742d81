"""The named effects become part of the model's graph."""
