"""Linear baselines: impulse response, ARX, state space, output error, residual tests."""
