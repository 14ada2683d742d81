"""The study of the gap workflow: answers on simulated vehicles with a hidden effect or fault."""
