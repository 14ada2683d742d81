"""Step 6: measured against predicted.

The residual is measured minus predicted in the output's unit. The response rule works on signals
oriented like phi = 1/lambda, for which rising is lean to rich.
"""

import math

import numpy as np

from monitor.types import FloatArray


def mean_and_std(residual: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation of a window, bit for bit as numpy's own, but faster."""
    n = len(residual)
    mean = np.add.reduce(residual) / n
    centred = residual - mean
    return float(mean), math.sqrt(np.add.reduce(centred * centred) / n)


def oriented(value: float, transform: str) -> float:
    """Return a value oriented like phi.

    transform : "phi" for lambda, which becomes 1/lambda; "none" for an output that rises towards
        lean as lambda does, which is negated
    """
    if transform == "phi":
        return 1.0 / value if value > 0.0 else float("nan")
    return -value


def lambda_of(oriented_values: FloatArray, transform: str) -> FloatArray:
    """Return values oriented like phi, none of them 0, in the output's unit again."""
    return 1.0 / oriented_values if transform == "phi" else -oriented_values
