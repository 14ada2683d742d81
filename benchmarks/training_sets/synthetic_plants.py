"""Synthetic systems of kinds that are usual in comparisons of system identification.

None of them is a NARX: two tanks that overflow, a hardening oscillator, a nonlinearity between two
filters, hysteresis. The oscillator's second record exceeds the amplitude of the training.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numba import njit
from scipy import signal

from benchmarks.training_sets.public_data import Plant, PlantRecord

WASHOUT, PERIOD_S, SEED = 50, 0.1, 1


def multisine(
    n: int, rng: np.random.Generator, band: tuple[float, float], rms: float
) -> np.ndarray:
    """Return n samples of random phases within ``band``, cycles per sample."""
    frequency = np.arange(n // 2 + 1) / n
    inside = (frequency >= band[0]) & (frequency <= band[1])
    spectrum = inside * np.exp(2j * np.pi * rng.random(len(frequency)))
    wave = np.fft.irfft(spectrum, n)
    return rms * wave / wave.std()


@njit
def tank_levels(pump: np.ndarray, level: float) -> np.ndarray:
    height = np.zeros(len(pump))
    upper, lower, step_s = level, level, 0.1
    for t in range(len(pump)):
        height[t] = lower
        for _ in range(40):
            out = 0.06 * np.sqrt(max(upper, 0.0))
            filled = upper + step_s * (0.05 * pump[t] - out)
            over = 0.6 * max(filled - 10.0, 0.0) / step_s
            lower = min(lower + step_s * (out - 0.055 * np.sqrt(max(lower, 0.0)) + over), 10.0)
            upper = min(filled, 10.0)
    return height


def tanks() -> Plant:
    """Two tanks that overflow at 10; 1,024 samples each."""

    def one(seed: int) -> PlantRecord:
        rng = np.random.default_rng(seed)
        pump = np.clip(2.9 + multisine(1024, rng, (0.0, 0.0576), 1.5), 0.0, 7.0)
        return _record(pump, tank_levels(pump, 5.0) + 0.02 * rng.standard_normal(1024))

    return _plant("tanks", [one(SEED)], {"test": one(SEED + 1)})


@njit
def oscillator_places(force: np.ndarray) -> np.ndarray:
    place = np.zeros(len(force))
    x, v, step = 0.0, 0.0, 0.7 / 8
    for t in range(len(force)):
        place[t] = x
        for _ in range(8):
            v += step * (force[t] - 0.1 * v - x - 0.1 * x * x - 0.5 * x * x * x)
            x += step * v
    return place


def oscillator() -> Plant:
    """A hardening spring; the second test record is a sweep of growing amplitude."""
    rng = np.random.default_rng(SEED)
    waves = [multisine(n, rng, (0.002, 0.11), 0.13) for n in (40_000, 8_192)]
    sweep = signal.sosfilt(signal.butter(6, 0.2, output="sos"), rng.standard_normal(20_000))
    waves.append(0.13 * sweep / sweep.std() * np.linspace(0.0, 2.0, 20_000))
    train, multi, arrow = (
        _record(w, oscillator_places(w) + 2e-4 * rng.standard_normal(len(w))) for w in waves
    )
    return _plant("oscillator", [train], {"multisine": multi, "arrow": arrow})


def sandwich() -> Plant:
    """A saturation between two filters of third order (Wiener-Hammerstein)."""

    def one(seed: int, n: int) -> PlantRecord:
        rng = np.random.default_rng(seed)
        u = signal.sosfilt(signal.butter(4, 0.4, output="sos"), rng.standard_normal(n))
        u /= u.std()
        x = signal.sosfilt(signal.cheby1(3, 0.5, 0.172, output="sos"), u)
        z = np.where(x > 0.0, 0.3 * np.tanh(2.67 * x) + 0.1 * x, x)
        y = np.asarray(signal.sosfilt(signal.cheby2(3, 40, 0.195, output="sos"), z))
        return _record(u, y + 1e-4 * rng.standard_normal(n))

    return _plant("sandwich", [one(SEED, 100_000)], {"test": one(SEED + 1, 20_000)})


@njit
def hysteresis_places(force: np.ndarray) -> np.ndarray:
    place = np.zeros(len(force))
    x, v, z, step_s = 0.0, 0.0, 0.0, 1.0 / 15_000
    for t in range(len(force)):
        place[t] = 1e3 * x
        for _ in range(20):
            a = (force[t] - 10.0 * v - 5e4 * x - z) / 2.0
            z += step_s * (5e4 * v - 1e3 * (0.8 * abs(v) * z - 1.1 * v * abs(z)))
            v += step_s * a
            x += step_s * v
    return place


def hysteresis() -> Plant:
    """A mass on a spring with hysteresis (Bouc-Wen)."""

    def one(seed: int, n: int) -> PlantRecord:
        rng = np.random.default_rng(seed)
        force = multisine(n, rng, (5 / 750, 150 / 750), 50.0)
        return _record(force, hysteresis_places(force) + 8e-3 * rng.standard_normal(n))

    return _plant("hysteresis", [one(SEED, 40_960)], {"test": one(SEED + 1, 8_192)})


def _record(u: np.ndarray, y: np.ndarray) -> PlantRecord:
    return PlantRecord(u[:, None], y)


def _plant(name: str, train: Sequence[PlantRecord], tests: dict[str, PlantRecord]) -> Plant:
    return Plant(
        name=f"synthetic {name}",
        period_s=PERIOD_S,
        unit="-",
        per_unit=1.0,
        washout=WASHOUT,
        train=tuple(train),
        tests=tests,
        goals={},
    )


SYSTEMS: Final[dict[str, Callable[[], Plant]]] = {
    "tanks": tanks,
    "oscillator": oscillator,
    "sandwich": sandwich,
    "hysteresis": hysteresis,
}
