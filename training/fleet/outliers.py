"""Vehicles that differ from their fleet, with a given chance of naming a sound one.

A vehicle's value is the median over its drives. Its distance from the fleet's median is measured in
the fleet's spread (1.4826 times the median absolute deviation, which a few faulty vehicles do not
widen). The limit is the distance that the farthest of n normally distributed values exceeds with
the given chance, divided by the number of statistics (Bonferroni). In a fleet of sound vehicles
with normally distributed values, this is the chance that any vehicle is named.
Sources: Hampel, The influence curve and its role in robust estimation, JASA 69, 1974 (median and
MAD). The limit is simulated, because the MAD of a small fleet varies.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import polars as pl
from scipy import stats

from monitor.base.types import FloatArray

RATE: Final = 0.05  # chance that one vehicle is named in a fleet of sound vehicles
LEAST_VEHICLES: Final = 10
LEAST_WINDOWS: Final = 10  # a drive with fewer windows does not count
MANY: Final = 1000  # from so many vehicles on the spread is practically exact
DRAWS: Final = 8000
MAD_TO_STD: Final = 1.4826


@dataclass(frozen=True, slots=True)
class Statistic:
    """A quantity by which vehicles are compared."""

    column: str  # in the table of recordings
    title: str
    unit: str
    is_log: bool = False  # compare the logarithm, for a spread, which is never negative


STATISTICS: Final = (
    Statistic("residual_mean", "mean residual", "output's unit"),
    Statistic("gain", "gain", "-"),
    Statistic("residual_std", "residual's spread", "output's unit", is_log=True),
)


@dataclass(frozen=True, slots=True)
class Standing:
    """The values of one statistic over a fleet, and their distances from the median."""

    statistic: Statistic
    vehicles: tuple[str, ...]
    values: FloatArray  # (n,) per vehicle, in the statistic's unit
    distance: FloatArray  # (n,) robust standard deviations from the fleet's median, signed
    limit: float  # of |distance|

    @property
    def out(self) -> tuple[int, ...]:
        """Return the indices of the vehicles beyond the limit, the farthest first."""
        order = np.argsort(-np.abs(self.distance), kind="stable")
        return tuple(int(i) for i in order if abs(self.distance[i]) > self.limit)


def standings(recordings: pl.DataFrame, rate: float = RATE) -> list[Standing]:
    """Return every statistic for which enough vehicles were judged.

    recordings : table of recordings
    rate : chance that one vehicle is named in a fleet of sound vehicles
    """
    counted = recordings.filter(pl.col("windows") >= LEAST_WINDOWS)
    by_vehicle = counted.group_by("vehicle", maintain_order=True).agg(
        pl.col(statistic.column).median() for statistic in STATISTICS
    )
    found = []
    for statistic in STATISTICS:
        part = by_vehicle.select("vehicle", statistic.column).drop_nulls()
        if len(part) >= LEAST_VEHICLES:
            values = part[statistic.column].to_numpy()
            found.append((statistic, tuple(part["vehicle"]), values))
    return [
        Standing(
            statistic,
            vehicles,
            values,
            robust(_compared(statistic, values)),
            limit_of(len(values), rate, len(found)),
        )
        for statistic, vehicles, values in found
    ]


def robust(values: FloatArray) -> FloatArray:
    """Return distances from the median in robust standard deviations, along the last axis.

    If more than half of the values are equal, the distance of the others is infinite.
    """
    centred = values - np.median(values, axis=-1, keepdims=True)
    spread = MAD_TO_STD * np.median(np.abs(centred), axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(centred / spread, nan=0.0, posinf=np.inf, neginf=-np.inf)


@lru_cache(maxsize=32)
def limit_of(n: int, rate: float = RATE, statistics: int = 1) -> float:
    """Return the distance that the farthest of ``n`` sound vehicles exceeds with chance ``rate``.

    statistics : number of statistics that share the chance

    >>> 4.4 < limit_of(10_000) < 4.7
    True
    """
    share = rate / statistics
    if n >= MANY:
        alone = -math.expm1(math.log1p(-share) / n)
        return float(stats.norm.isf(alone / 2.0))
    rng = np.random.default_rng(0)
    farthest = [
        np.abs(robust(rng.standard_normal((100, n)))).max(axis=1) for _ in range(DRAWS // 100)
    ]
    return float(np.quantile(np.concatenate(farthest), 1.0 - share))


def _compared(statistic: Statistic, values: FloatArray) -> FloatArray:
    return np.log(np.maximum(values, 1e-12)) if statistic.is_log else values


def named(found: Sequence[Standing]) -> dict[str, list[tuple[Standing, int]]]:
    """Return the vehicles beyond a limit with their statistics, the farthest first."""
    every = [(each, i) for each in found for i in each.out]
    every.sort(key=lambda pair: -abs(float(pair[0].distance[pair[1]])))
    vehicles: dict[str, list[tuple[Standing, int]]] = {}
    for each, i in every:
        vehicles.setdefault(each.vehicles[i], []).append((each, i))
    return vehicles
