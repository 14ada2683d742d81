"""Studies: the paper's study, the detection matrix, the gap study."""
