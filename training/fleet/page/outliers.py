"""Vehicles that stand out of their fleet, with a bounded chance of a false alarm.

The value of a vehicle is the median over its drives. Its distance is measured from the median of
the fleet, in units of the fleet's spread: 1.4826 times the median absolute deviation (MAD), which a
few faulty vehicles do not widen. In a fleet of sound vehicles with normally distributed values, the
chance that any vehicle exceeds the limit is the given rate, shared among the statistics
(Bonferroni). For small fleets a simulation sets the limit, because the MAD varies.
Source of median and MAD: Hampel, The influence curve and its role in robust estimation, JASA 69,
1974.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import polars as pl
from scipy.special import ndtri

from monitor.base.types import FloatArray

RATE: Final = 0.05  # chance that any vehicle of a sound fleet stands out
LEAST_VEHICLES: Final = 10  # with a value of the statistic
LEAST_WINDOWS: Final = 10  # of a drive; drives with fewer windows do not count
MANY: Final = 1000  # vehicles from which the spread of the MAD no longer matters
DRAWS: Final = 8000  # simulated fleets
MAD_TO_STD: Final = 1.4826


@dataclass(frozen=True, slots=True)
class Statistic:
    """A value by which vehicles are compared."""

    column: str  # of the table of recordings
    title: str
    has_unit: bool = True  # that of the output
    is_log: bool = False  # compare logarithms, for a spread, which is never negative


STATISTICS: Final = (
    Statistic("residual_mean", "mean residual"),
    Statistic("gain", "gain", has_unit=False),
    Statistic("residual_std", "residual's spread", is_log=True),
)


@dataclass(frozen=True, slots=True)
class Standing:
    """One statistic over the vehicles of a fleet."""

    statistic: Statistic
    vehicles: tuple[str, ...]  # n names
    values: FloatArray  # (n,) unit of the statistic
    distance: FloatArray  # (n,) from the median of the fleet, signed, robust standard deviations
    limit: float  # of the absolute distance

    @property
    def out(self) -> tuple[int, ...]:
        """Return the indices of the vehicles that stand out, the farthest first."""
        order = np.argsort(-np.abs(self.distance), kind="stable")
        return tuple(int(i) for i in order if abs(self.distance[i]) > self.limit)


def standings(recordings: pl.DataFrame) -> list[Standing]:
    """Return the statistics that at least 10 vehicles have, from the table of recordings."""
    counted = recordings.filter(pl.col("windows") >= LEAST_WINDOWS)
    medians = counted.group_by("vehicle", maintain_order=True).agg(
        pl.col(statistic.column).median() for statistic in STATISTICS
    )
    by_statistic = []
    for statistic in STATISTICS:
        part = medians.select("vehicle", statistic.column).drop_nulls()
        if len(part) >= LEAST_VEHICLES:
            values = part[statistic.column].to_numpy()
            by_statistic.append((statistic, tuple(part["vehicle"]), values))
    return [
        Standing(
            statistic,
            vehicles,
            values,
            robust(np.log(np.maximum(values, 1e-12)) if statistic.is_log else values),
            limit_of(len(values), RATE, len(by_statistic)),
        )
        for statistic, vehicles, values in by_statistic
    ]


def robust(values: FloatArray) -> FloatArray:
    """Return the distances from the median in robust standard deviations, along the last axis.

    If most values are equal, the other values have an infinite distance.
    """
    centred = values - np.median(values, axis=-1, keepdims=True)
    spread = MAD_TO_STD * np.median(np.abs(centred), axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(centred / spread, nan=0.0, posinf=np.inf, neginf=-np.inf)


@lru_cache(maxsize=32)
def limit_of(n: int, rate: float = RATE, statistics: int = 1) -> float:
    """Return the distance that the farthest of ``n`` sound vehicles exceeds with chance ``rate``.

    statistics : number of statistics that share the chance
    The distance is in robust standard deviations.

    >>> 4.4 < limit_of(10_000) < 4.7
    True
    """
    share = rate / statistics
    if n >= MANY:
        alone = -math.expm1(math.log1p(-share) / n)
        return -float(ndtri(alone / 2.0))
    rng = np.random.default_rng(0)
    farthest = [
        np.abs(robust(rng.standard_normal((100, n)))).max(axis=1) for _ in range(DRAWS // 100)
    ]
    return float(np.quantile(np.concatenate(farthest), 1.0 - share))


def named(found: Sequence[Standing]) -> dict[str, list[tuple[Standing, int]]]:
    """Return the vehicles that stand out by any statistic, the farthest first.

    The result maps a vehicle to its statistics and to its index in them.
    """
    every = [(standing, i) for standing in found for i in standing.out]
    every.sort(key=lambda pair: -abs(float(pair[0].distance[pair[1]])))
    vehicles: dict[str, list[tuple[Standing, int]]] = {}
    for standing, i in every:
        vehicles.setdefault(standing.vehicles[i], []).append((standing, i))
    return vehicles
