"""Outcome: choice of the model, sensor, linear models, steady training, the paper's figures."""
