"""Vehicles that stand out of their fleet, with a stated chance of calling a sound one so.

A vehicle's value is the median over its drives. It is compared with the fleet's median, in units of
the fleet's spread (1.4826 times the median absolute deviation, which a few faulty vehicles do not
widen). The limit is the distance that the farthest of so many normally distributed values exceeds
with the chance given, divided by the number of statistics (Bonferroni): in a fleet of sound
vehicles whose values are normally distributed, that is the chance that any vehicle at all is named.
Sources: Hampel, The influence curve and its role in robust estimation, JASA 69, 1974 (median and
MAD); the limit is found by simulation, since for small fleets the MAD itself varies.
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

RATE: Final = 0.05  # chance that a fleet of sound vehicles has one that stands out
LEAST_VEHICLES: Final = 10
LEAST_WINDOWS: Final = 10  # of a drive that counts
MANY: Final = 1000  # vehicles from which on the spread is as good as known
DRAWS: Final = 8000
MAD_TO_STD: Final = 1.4826


@dataclass(frozen=True, slots=True)
class Statistic:
    """What vehicles are compared by."""

    column: str  # of the table of recordings
    title: str
    unit: str
    is_log: bool = False  # compared by its logarithm: a spread, which is never negative


STATISTICS: Final = (
    Statistic("residual_mean", "mean residual", "output's unit"),
    Statistic("gain", "gain", "-"),
    Statistic("residual_std", "residual's spread", "output's unit", is_log=True),
)


@dataclass(frozen=True, slots=True)
class Standing:
    """One statistic over a fleet."""

    statistic: Statistic
    vehicles: tuple[str, ...]
    values: FloatArray  # (n,) of each vehicle, statistic's unit
    distance: FloatArray  # (n,) robust standard deviations from the fleet's median, signed
    limit: float  # of the distance

    @property
    def out(self) -> tuple[int, ...]:
        """Return which vehicles stand out, the farthest first."""
        order = np.argsort(-np.abs(self.distance), kind="stable")
        return tuple(int(i) for i in order if abs(self.distance[i]) > self.limit)


def standings(recordings: pl.DataFrame, rate: float = RATE) -> list[Standing]:
    """Return every statistic for which enough vehicles were judged.

    recordings : the table of recordings
    rate : chance that a fleet of sound vehicles has one that stands out
    """
    counted = recordings.filter(pl.col("windows") >= LEAST_WINDOWS)
    own = counted.group_by("vehicle", maintain_order=True).agg(
        pl.col(each.column).median() for each in STATISTICS
    )
    found = []
    for statistic in STATISTICS:
        part = own.select("vehicle", statistic.column).drop_nulls()
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

    Values that are all alike, but for some, are infinitely far from those.
    """
    centred = values - np.median(values, axis=-1, keepdims=True)
    spread = MAD_TO_STD * np.median(np.abs(centred), axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(centred / spread, nan=0.0, posinf=np.inf, neginf=-np.inf)


@lru_cache(maxsize=32)
def limit_of(n: int, rate: float = RATE, statistics: int = 1) -> float:
    """Return the distance that the farthest of ``n`` sound vehicles exceeds with the chance given.

    statistics : how many are looked at, among which the chance is shared

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
    """Return the vehicles that stand out by any statistic, the farthest first."""
    every = [(each, i) for each in found for i in each.out]
    every.sort(key=lambda pair: -abs(float(pair[0].distance[pair[1]])))
    vehicles: dict[str, list[tuple[Standing, int]]] = {}
    for each, i in every:
        vehicles.setdefault(each.vehicles[i], []).append((each, i))
    return vehicles
