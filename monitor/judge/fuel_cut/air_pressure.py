"""The reading of a wide-range sensor in air depends on pressure, unless the ECU corrects it.

Oxygen reaches the pump cell through a diffusion barrier, whose pores are about as wide as the free
path of the gas. So the pump current grows with pressure, and less than in proportion. Healthy
recordings at different pressures tell by which share of this the reading does so: 0 if the ECU
corrects it, 1 if not. Without them the share is anything between.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

SIGNAL: Final = "ambient_pressure_kpa"  # in a fuel cut at low speed about that of the exhaust
STANDARD_KPA: Final = 101.3
PORE_KPA: Final = 47.0  # at which half of the diffusion depends on pressure; 10 % less at 75 kPa
SHARE_STD: Final = 12.0**-0.5  # of a share between 0 and 1 of which nothing is known


def log_current(pressure_kpa: float) -> float:
    """Return the logarithm of the pump current in air over that at 101.3 kPa.

    Source: Bosch's formula Ip(p) = Ip(p0) p / (k + p) (k + p0) / p0.

    >>> round(math.exp(log_current(75.0)), 3)
    0.9
    """
    at = math.log(pressure_kpa / (PORE_KPA + pressure_kpa))
    return at - math.log(STANDARD_KPA / (PORE_KPA + STANDARD_KPA))


@dataclass(frozen=True, slots=True)
class AirPressure:
    """How the reading of healthy sensors in air depends on pressure."""

    kpa: float  # at which the healthy level holds
    share: float  # of the uncorrected dependence
    share_std: float

    def span(self, pressure_kpa: float) -> tuple[float, float]:
        """Return the span of the reading over that at ``kpa``, and its relative standard deviation.

        >>> AirPressure(101.3, 1.0, 0.0).span(75.0)[0] < 0.91
        True
        """
        beyond = log_current(pressure_kpa) - log_current(self.kpa)
        return math.exp(self.share * beyond), self.share_std * abs(beyond)


def learned(
    pressures_kpa: Sequence[float], spans: Sequence[float], least_std: float
) -> AirPressure:
    """Return the dependence that the mean pressures and spans of healthy drives show.

    least_std : relative, by which spans differ from drive to drive at least
    The share is a mean of what is known before, and of the slope over the drives, each with its
    precision; drives at one pressure show no slope.
    """
    x = np.array([log_current(p) for p in pressures_kpa])
    y = np.log(spans)
    kpa = float(np.exp(np.mean(np.log(pressures_kpa))))
    x, y = x - x.mean(), y - y.mean()
    moment = float(x @ x)
    slope = float(x @ y) / moment if moment else 0.5
    var = max(float(np.square(y - slope * x).sum()) / max(len(x) - 2, 1), least_std**2)
    precision = moment / var
    before = SHARE_STD**-2
    share = (0.5 * before + slope * precision) / (before + precision)
    share_std = (before + precision) ** -0.5
    return AirPressure(round(kpa, 2), round(min(max(share, 0.0), 1.0), 4), round(share_std, 4))
