"""The NARX study: 29 models, four algorithms, the best tuned in closed loop."""
