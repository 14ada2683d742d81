"""What healthy drives show: the yardstick of every score."""
