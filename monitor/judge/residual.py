"""Step 6: measured against predicted.

The residual is measured minus predicted in the output's unit. The response rule works on signals
oriented like phi = 1/lambda, for which rising is lean to rich.
"""

import numpy as np

from monitor.base.types import FloatArray


def oriented(values: FloatArray, transform: str) -> FloatArray:
    """Return values oriented like phi; NaN where lambda is not above zero.

    transform : "phi" for lambda, which becomes 1/lambda; "none" for an output that rises towards
        lean as lambda does, which is negated
    """
    if transform != "phi":
        return -values
    return np.asarray(1.0 / np.where(values > 0.0, values, np.nan))


def lambda_of(oriented_values: FloatArray, transform: str) -> FloatArray:
    """Return values oriented like phi, none of them 0, in the output's unit again."""
    return 1.0 / oriented_values if transform == "phi" else -oriented_values


def whitened(x: FloatArray, memory: float) -> FloatArray:
    """Return the new part of each sample of windows, (w, n, ...), its mean taken off.

    memory : correlation of neighbouring samples
    """
    new: FloatArray = x[:, 1:] - memory * x[:, :-1]
    new -= new.mean(axis=1, keepdims=True)
    return new
