"""What equations are made of: arithmetic, lags and delays on arrays or on a graph's tensors."""
