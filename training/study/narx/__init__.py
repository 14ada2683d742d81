"""NARX study: 29 models, four algorithms; the best models are tuned in closed loop."""
