"""Studies on many recordings: the paper's study, the detection matrix, the gap study."""
