"""Plants that no method under test has as its equation.

They are continuous: exact solutions by scipy between the samples, dead times that are no whole
number of samples.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import cont2discrete, dlsim, lfilter

from monitor.base.types import FloatArray
from training.narx.linear.arx import solve_arx, triangle
from training.narx.linear.models import LinearModel, Stretch

RNG = np.random.default_rng
PERIOD_S = 0.1
FINE = 10  # solution steps per sample
TANK_PERIOD_S = 0.25


def held_steps(n: int, k: int, rng: np.random.Generator, longest: int = 25) -> FloatArray:
    """Inputs that hold a level for 2 to ``longest`` samples."""
    u = np.empty((n, k))
    for i in range(k):
        edges = np.cumsum(rng.integers(2, longest, n))
        u[:, i] = rng.standard_normal(n)[np.searchsorted(edges, np.arange(n), side="right")]
    return u


def coloured(n: int, rng: np.random.Generator, pole: float = 0.9) -> FloatArray:
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(n)))


def continuous(
    u: FloatArray, numerator: float, denominator: list[float], dead_s: float
) -> FloatArray:
    """Exact response of numerator / denominator(s) exp(-dead_s s) to an input held per sample."""
    fine = np.repeat(u, FINE)
    late = round(dead_s / PERIOD_S * FINE)
    fine = np.concatenate([np.full(late, fine[0]), fine])[: len(fine)]
    system = cont2discrete(([numerator], denominator), PERIOD_S / FINE)
    numerator_z, denominator_z = np.ravel(system[0]), np.ravel(system[1])
    return np.asarray(lfilter(numerator_z, denominator_z, fine))[::FINE]


def two_inputs(n: int, seed: int, noise: float = 0.05) -> Stretch:
    """Second order after 0.53 s of dead time, first order after 0.21 s, coloured noise."""
    rng = RNG(seed)
    u = held_steps(n, 2, rng)
    y = continuous(u[:, 0], 1.0, [0.04, 0.4, 1.0], 0.53)
    y += continuous(u[:, 1], -0.5, [0.3, 1.0], 0.21)
    return u, y + noise * coloured(n, rng)


def modes(n: int, rng: np.random.Generator, poles: FloatArray, disturbed: float) -> Stretch:
    """Continuous first-order modes of these poles (1/s), states disturbed, sensor noise."""
    readout = np.array([[1.0, -2.0, 1.5]])
    system = (np.diag(poles), np.ones((len(poles), 2)), readout, np.zeros((1, 2)))
    discrete = cont2discrete(system, PERIOD_S)
    u = rng.standard_normal((n, 1))
    driven = np.column_stack([u, disturbed * rng.standard_normal(n)])
    y = dlsim(discrete, driven)[1][:, 0]
    return u, y + 0.2 * disturbed * rng.standard_normal(n)


def fit_arx(records: Sequence[Stretch], na: int, nb: int, *delays: int) -> LinearModel:
    """The least-squares ARX model with orders ``na`` and ``nb`` and a dead time for each input."""
    return solve_arx(triangle(records, na, max(delays) + nb - 1), na, nb, delays)


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
