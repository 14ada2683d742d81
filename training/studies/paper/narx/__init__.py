"""The NARX study: 29 models, four algorithms; the best are tuned in closed loop."""
