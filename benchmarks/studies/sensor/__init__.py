"""Detection matrix: detection and false-alarm rates on many simulated drives."""
