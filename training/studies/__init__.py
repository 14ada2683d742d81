"""Studies: the detection matrix, the gap study."""
