"""Linear models of the samples: ARX of all orders, its free run, lagged regressors."""
