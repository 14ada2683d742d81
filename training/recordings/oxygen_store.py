"""The oxygen that a catalyst holds, as an input of models: an integral with ends.

A network with some seconds of memory cannot know it: a catalyst forgets nothing until it is full or
empty.
"""

import numpy as np

from monitor.base.types import FloatArray

OXYGEN_IN_AIR = 0.23  # mass fraction


def held_g(
    lambda_upstream: FloatArray, air_g_s: FloatArray, period_s: float, capacity_g: float
) -> FloatArray:
    """Return the oxygen in g after each sample, (n,), of a store that begins half full.

    0.23 · air flow · (1 - 1/lambda) enters, and the store stays between empty and ``capacity_g``.
    A sample that is not known changes nothing.

    >>> held_g(np.array([1.25, 1.25, 0.8]), np.full(3, 10.0), 1.0, 0.8).round(3).tolist()
    [0.8, 0.8, 0.225]
    """
    inflow = OXYGEN_IN_AIR * air_g_s * (1.0 - 1.0 / np.maximum(lambda_upstream, 0.1)) * period_s
    held, found = 0.5 * capacity_g, []
    for each in np.nan_to_num(inflow).tolist():
        held = min(max(held + each, 0.0), capacity_g)
        found.append(held)
    return np.array(found)
