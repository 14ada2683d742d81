"""The study of the gap workflow: its answers on simulated vehicles with a hidden effect."""
