"""Drives with a residual of known making, for the tests of localising."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from training.greybox.fit.comparison import Comparison

PERIOD_S = 0.1
DEAD_S = 0.3
NOISE = 0.004

Signals = Mapping[str, FloatArray]


@dataclass(frozen=True)
class Made:
    """What a hidden effect may depend on."""

    signals: Signals
    phi: FloatArray  # (n,) predicted
    t_s: FloatArray


Effect = Callable[[Made], FloatArray]


def to_sensor(x: FloatArray) -> FloatArray:
    """Delay by the dead time and smooth by 0.2 s, as the prediction is."""
    k = round(DEAD_S / PERIOD_S)
    late = np.concatenate([np.full(k, x[0]), x[:-k]])
    keep = np.exp(-PERIOD_S / 0.2)
    return np.asarray(lfilter([1 - keep], [1, -keep], late, zi=[keep * late[0]])[0])


def _wander(rng: np.random.Generator, n: int, tau_s: float, low: float, high: float) -> FloatArray:
    keep = np.exp(-PERIOD_S / tau_s)
    x = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(n))
    return np.asarray(low + (high - low) * (np.tanh(x) + 1) / 2)


def coloured(rng: np.random.Generator, n: int, memory: float) -> FloatArray:
    """Noise of standard deviation ``NOISE`` in which one sample remembers the last."""
    driven = rng.standard_normal(n) * NOISE * np.sqrt(1 - memory**2)
    return np.asarray(lfilter([1], [1, -memory], driven))


def drive(
    seed: int, *effects: Effect, n: int = 6000, memory: float = 0.7, name: str = ""
) -> Comparison:
    """A drive on which the prediction lacks these effects."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(n) * PERIOD_S
    rpm, air = _wander(rng, n, 8, 900, 4000), _wander(rng, n, 3, 80, 600)
    edges = np.sign(np.sin(2 * np.pi * t_s / 1.7 + rng.uniform(0, 6)))
    commanded = 1 + 0.015 * edges + 0.01 * _wander(rng, n, 2, -1, 1)
    signals = {
        "air_mass_mg": air,
        "fuel_mass_mg": air * commanded / 14.7,
        "engine_speed_rpm": rpm,
        "maf_kg_h": air * rpm * 1.2e-4,
        "rail_pressure_mpa": _wander(rng, n, 5, 5, 20),
        "coolant_temperature_degc": 90 - 60 * np.exp(-t_s / rng.uniform(100, 250)),
        "purge_duty_percent": np.clip(_wander(rng, n, 30, -60, 80), 0, None),
    }
    phi = to_sensor(commanded)
    made = Made(signals, phi, t_s)
    measured = phi + coloured(rng, n, memory) + sum(effect(made) for effect in effects)
    cut = lfilter([1], [1, -0.99], (rng.random(n) < 0.002) * 1.0) > 0.6
    return Comparison(
        name=name or f"drive {seed}",
        period_s=PERIOD_S,
        signals=signals,
        phi_measured=measured,
        phi_predicted=phi,
        scored=~cut,
    )


def at_sensor(made: Made) -> FloatArray:
    """The sensor reads richer at high flow, at once."""
    return 0.006 * (made.signals["maf_kg_h"] / 100 - 1)


def purge(made: Made) -> FloatArray:
    """Vapour enters with the charge and is diluted by the air."""
    flow = np.maximum(made.signals["maf_kg_h"], 10)
    return to_sensor(0.006 * made.signals["purge_duty_percent"] / flow)


def late_edges(made: Made) -> FloatArray:
    """Dead time longer than predicted at low flow, shorter at high."""
    return -np.gradient(made.phi, PERIOD_S) * 0.06 * (1 - made.signals["maf_kg_h"] / 100)


def wall_film(made: Made) -> FloatArray:
    """A part of every step of fuel is missing at first."""
    fuel = made.signals["fuel_mass_mg"]
    return to_sensor(-0.0004 * np.diff(fuel, prepend=fuel[0]) / PERIOD_S)


def onset(made: Made) -> FloatArray:
    """An offset from 200 s on."""
    return 0.004 * (made.t_s > 200.0)


def own_error(made: Made) -> FloatArray:
    """What the model errs on healthy drives, too."""
    return 0.004 * (made.signals["air_mass_mg"] / 300 - 1) - np.gradient(made.phi, PERIOD_S) * 0.02
