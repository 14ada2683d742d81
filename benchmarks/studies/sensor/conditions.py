"""Conditions of a simulated drive: the weather, and the ageing of a healthy sensor."""

from typing import Final

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.faults import Fault
from training.dyno import vehicle
from training.dyno.vehicle import Conditions

AMBIENTS: Final = ("mild", "hot", "cold", "altitude")


def weather(ambient: str, seed: int) -> Conditions:
    """Return ambient conditions and coolant temperature, drawn by ``seed`` for a kind of weather.

    Raises UsageError for an unknown kind.
    """
    rng = np.random.default_rng([0x0_2, 7, seed])
    degc, kpa = rng.uniform(5.0, 30.0), rng.uniform(94.0, 103.0)
    warm = rng.uniform(65.0, 92.0) if rng.random() < 2.0 / 3.0 else None
    if ambient == "hot":
        degc = rng.uniform(35.0, 43.0)
    elif ambient == "cold":
        degc, warm = rng.uniform(-15.0, -5.0), None
    elif ambient == "altitude":
        kpa = rng.uniform(72.0, 80.0)
    elif ambient != "mild":
        raise UsageError(f"ambient {ambient!r} is unknown; there are {', '.join(AMBIENTS)}")
    return vehicle.conditions(seed)._replace(
        ambient_degc=float(degc),
        ambient_kpa=float(kpa),
        coolant_start_degc=float(degc if warm is None else warm),
    )


def ageing(seed: int) -> Fault:
    """Return a random ageing of a healthy sensor, within its specification.

    The lag is up to 0.15 s and the dead time up to 0.1 s, together at most 0.2 s, because a
    specification limits the whole response. The gain is at least 0.85, the offset at most 0.008
    lambda either way.
    """
    rng = np.random.default_rng([0x0_2, 8, seed])
    lag_s = float(rng.uniform(0.0, 0.15))
    return Fault(
        "aged",
        lag_s,
        tau_rising_s=lag_s,
        tau_falling_s=lag_s,
        delay_s=float(rng.uniform(0.0, min(0.1, 0.2 - lag_s))),
        gain=float(rng.uniform(0.85, 1.0)),
        offset_lambda=float(rng.uniform(-0.008, 0.008)),
    )
