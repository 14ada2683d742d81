"""What fuel cuts show in healthy drives, with its spread, for the model card."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from monitor.base.config import Config
from monitor.judge.fuel_cut.air_pressure import AirPressure, learned
from monitor.judge.fuel_cut.cuts import LEVEL, QUANTITIES, Cut
from monitor.judge.fuel_cut.response import FuelCutReference, HealthyCuts

LEAST_DRIVES: Final = 2  # that show a quantity
LEAST_CUTS: Final = 6  # that they show in all
STEP_SHARE: Final = 0.29  # standard deviation of a time known to one sample, in samples
CLIPPED_SHARE: Final = 0.5  # of the levels; if so many do not move and are alike, the range ends


def reference_of(
    drives: Sequence[Sequence[Cut]], config: Config, transform: str, period_s: float
) -> FuelCutReference | None:
    """Return what the fuel cuts of healthy drives show, None if they show nothing.

    transform : of the model; a level has a meaning only in phi
    """
    levels = [cut for cuts in drives for cut in cuts if LEVEL in cut.seen]
    leanest = min((cut.seen[LEVEL].measured for cut in levels), default=0.0)
    at_end = [
        cut.is_flat and cut.seen[LEVEL].measured - leanest <= config.plausibility.stuck_range
        for cut in levels
    ]
    is_clipped = sum(at_end) > CLIPPED_SHARE * len(levels)
    pressure = None if is_clipped or transform != "phi" else _pressure(drives, config)
    healthy: dict[str, HealthyCuts] = {}
    for name in QUANTITIES:
        if name == LEVEL and (is_clipped or transform != "phi"):
            if is_clipped and transform == "phi":
                healthy[name] = HealthyCuts(round(leanest, 5), 0.0, 0.0)
            continue
        own = [_values(cuts, name, pressure) for cuts in drives]
        own = [values for values in own if len(values)]
        if len(own) >= LEAST_DRIVES and sum(map(len, own)) >= LEAST_CUTS:
            least = 0.0 if name == LEVEL else STEP_SHARE * period_s
            healthy[name] = _healthy(own, least)
    return FuelCutReference(healthy, is_clipped, pressure) if healthy else None


def _pressure(drives: Sequence[Sequence[Cut]], config: Config) -> AirPressure | None:
    """Return how the level depends on pressure, None where a level's pressure is not known."""
    levels = [[cut for cut in cuts if LEVEL in cut.seen] for cuts in drives]
    levels = [cuts for cuts in levels if cuts]
    kpa = [float(np.mean([cut.pressure_kpa for cut in cuts])) for cuts in levels]
    spans = [float(np.mean([1.0 - cut.seen[LEVEL].measured for cut in cuts])) for cuts in levels]
    if not levels or not np.isfinite(kpa).all() or min(spans) <= 0.0:
        return None
    return learned(kpa, spans, config.fuel_cut.humidity_spread)


def _values(cuts: Sequence[Cut], name: str, pressure: AirPressure | None) -> np.ndarray:
    """Return a quantity of a drive's cuts: measured less predicted, or the level.

    The level is that at the pressure of the reference.
    """
    shown = [cut for cut in cuts if name in cut.seen]
    if name != LEVEL:
        return np.array([c.seen[name].measured - c.seen[name].predicted for c in shown])
    spans = np.array([1.0 - c.seen[LEVEL].measured for c in shown])
    healthy = np.array([pressure.span(c.pressure_kpa)[0] if pressure else 1.0 for c in shown])
    return 1.0 - spans / healthy


def _healthy(drives: Sequence[np.ndarray], least: float) -> HealthyCuts:
    """Return mean and spreads over drives.

    least : spread of drives at least
    """
    means = np.array([values.mean() for values in drives])
    squares = sum(float(np.square(values - values.mean()).sum()) for values in drives)
    within = squares / max(sum(map(len, drives)) - len(drives), 1)
    return HealthyCuts(
        mean=round(float(means.mean()), 5),
        std=round(float(np.sqrt(within)), 5),
        drive_std=round(max(float(means.std(ddof=1)), least), 5),
    )
