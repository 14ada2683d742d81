"""The parts of which effects are made: parameters, quantities, lags, arithmetic."""
