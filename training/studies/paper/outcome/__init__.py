"""The chosen model: choice, sensor, linear models beside it, steady training, the paper."""
