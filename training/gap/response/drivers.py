"""Variables that a difference may depend on: the signals, and a few made from them."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.signals import BY_NAME
from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.greybox.fit.drive import Comparison, in_fuel_cut
from training.recordings.samples.rows import hold

LIMITS: Final = CONFIG.drivers

# What a reader calls them; any other signal goes by its own name without the unit.
WORDS: Final[Mapping[str, str]] = {
    "air_mass_mg": "load (air per stroke)",
    "fuel_mass_mg": "fuel per stroke",
    "maf_kg_h": "air flow",
    "after_fuel_cut_s": "time since fuel cut",
    "fuel_rate_mg_s": "rate of fuel per stroke",
    "load_rate_mg_s": "rate of load",
    "phi_slope_1_s": "edge direction (slope of phi)",
    "phi_predicted": "predicted phi",
}
UNITS: Final[Mapping[str, str]] = {
    **{name: signal.unit for name, signal in BY_NAME.items()},
    "after_fuel_cut_s": "s",
    "fuel_rate_mg_s": "mg/s",
    "load_rate_mg_s": "mg/s",
    "phi_slope_1_s": "1/s",
}
SUFFIX: Final = re.compile(r"_(kg_h|km_h|degc|percent|mpa|kpa|rpm|nm|v)$")
# States and targets rather than causes, and what the loop is closed through.
NO_DRIVERS: Final = frozenset({"closed_loop", "fuel_cut", "sensor_ready", "lambda_measured"})


def name_of(driver: str) -> str:
    """Return what a reader calls a driver.

    >>> name_of("manifold_pressure_kpa")
    'manifold pressure'
    """
    return WORDS.get(driver) or SUFFIX.sub("", driver).replace("_", " ")


@dataclass(frozen=True, slots=True)
class Driver:
    """A variable in each recording, without missing values."""

    name: str
    values: tuple[FloatArray, ...]


def find_drivers(recordings: Sequence[Comparison]) -> list[Driver]:
    """Return the signals that all recordings have and that move, and those made from them."""
    found = [
        Driver(name, tuple(r.signals[name] for r in recordings))
        for name in recordings[0].signals
        if name not in NO_DRIVERS and all(name in r.signals for r in recordings)
    ]
    for name, make in DERIVED.items():
        values = tuple(made for r in recordings if (made := make(r)) is not None)
        if len(values) == len(recordings):
            found.append(Driver(name, values))
    rows = [r.scored for r in recordings]
    seen = [np.concatenate([v[s] for v, s in zip(d.values, rows, strict=True)]) for d in found]
    return [d for d, x in zip(found, seen, strict=True) if len(np.unique(x)) >= LIMITS.values_min]


def rate(values: FloatArray, period_s: float) -> FloatArray:
    """Return the rate of change (n,) of ``values`` over the last ``rate_s``, per second."""
    k = max(round(LIMITS.rate_s / period_s), 1)
    before = np.concatenate([np.full(min(k, len(values)), values[0]), values[:-k]])
    return np.asarray((values - before[: len(values)]) / (k * period_s))


def after_fuel_cut(r: Comparison) -> FloatArray | None:
    """Return the time since the last fuel cut (n,) in s; None if no signal tells cuts."""
    cut = in_fuel_cut(r.signals)
    if cut is None:
        return None
    n = len(cut)
    last = np.maximum.accumulate(np.where(cut, np.arange(n), -(10**9)))
    return np.minimum((np.arange(n) - last) * r.period_s, LIMITS.cut_memory_s)


def phi_slope(r: Comparison) -> FloatArray:
    """Return the slope of the predicted phi (n,), per second."""
    return rate(hold(r.phi_predicted), r.period_s)


def _rate_of(name: str) -> Callable[[Comparison], FloatArray | None]:
    return lambda r: rate(r.signals[name], r.period_s) if name in r.signals else None


DERIVED: Final[Mapping[str, Callable[[Comparison], FloatArray | None]]] = {
    "after_fuel_cut_s": after_fuel_cut,
    "fuel_rate_mg_s": _rate_of("fuel_mass_mg"),
    "load_rate_mg_s": _rate_of("air_mass_mg"),
    "phi_slope_1_s": phi_slope,
    "phi_predicted": lambda r: hold(r.phi_predicted),
}
