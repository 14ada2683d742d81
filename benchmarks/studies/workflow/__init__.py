"""The gap study: answers of the gap workflow on simulated vehicles with a hidden effect."""
