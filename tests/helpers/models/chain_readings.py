"""A chain of known constants and its readings, made of plain formulas."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.fit.drive import ChainDrive

PERIOD_S = 0.1

TRUE = Constants(
    gain=1.01, dead_time_s=0.17, dead_time_revolutions=1.5, mixing_s=0.05, sensor_s=0.12, span=0.95
)


def steps(rng: np.random.Generator, n: int, longest: int) -> NDArray[np.int64]:
    """Return which of steps of 5 samples and more each of n samples belongs to."""
    return np.searchsorted(np.cumsum(rng.integers(5, longest, n)), np.arange(n), side="right")


def synthetic(seed: int, n: int = 6000) -> tuple[dict[str, FloatArray], FloatArray]:
    """Signals and the reading of a chain with the constants TRUE and a slow noise."""
    rng = np.random.default_rng([seed, 7])
    hold = steps(rng, n, 25)
    mixture = (1.0 + 0.03 * rng.choice([-1.0, 1.0], n))[hold]
    signals = {
        "fuel_mass_mg": 300.0 / 14.7 * mixture,
        "air_mass_mg": np.full(n, 300.0),
        "engine_speed_rpm": rng.uniform(800.0, 3000.0, n)[hold],
    }
    noise = lfilter([1.0], [1.0, -1.3, 0.35], 0.002 * rng.standard_normal(n))
    return signals, simulate(base_path(TRUE, signals), PERIOD_S) + noise


def read_drive(
    signals: dict[str, FloatArray], phi: FloatArray, scored: BoolArray | None = None
) -> ChainDrive:
    """Return a drive of which all but the first 5 s are scored, or these samples."""
    if scored is None:
        scored = np.arange(len(phi)) >= 50
    return ChainDrive(name="", period_s=PERIOD_S, signals=signals, phi_measured=phi, scored=scored)
