"""Studies: the paper, the detection matrix, the gap study."""
