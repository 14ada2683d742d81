"""The parts of which effects are made: parameters, signals, lags, and their nodes."""
