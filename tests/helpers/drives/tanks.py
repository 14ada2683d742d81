"""Tanks that the studies are tested on: real enough, and no NARX."""

import numpy as np

from monitor.base.types import FloatArray

TANK_PERIOD_S = 0.25


def leaking_tank(
    n: int, seed: int, leak_mean: float, longest: int = 60
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Valve, leak and measured level of a tank that empties by the root of its level.

    longest : most samples for which the valve holds
    """
    rng = np.random.default_rng(seed)
    edges = np.cumsum(rng.integers(5, longest, n))
    valve = rng.uniform(0, 1, n)[np.searchsorted(edges, np.arange(n), side="right")]
    leak = leak_mean + 0.3 * np.sin(np.arange(n) / 37.0) + 0.02 * rng.standard_normal(n)
    level, measured = 1.0, np.empty(n)
    for t in range(n):
        level = max(level + 0.08 * valve[t - 2 if t > 1 else 0] - 0.06 * leak[t] * level**0.5, 0)
        measured[t] = level + 0.005 * rng.standard_normal()
    return valve, leak, measured
