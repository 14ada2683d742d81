"""Claims about the sensor: its lag or dead time, and the range of its gain."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Final

from monitor.base.config import ResponseConfig
from monitor.base.faults import TRANSIENT_GAIN
from monitor.judge.response.bank import Hypothesis, build

# a slow sensor with at least this gain is only slow, with less it is weak, too
SLOW_LEAST: Final = math.sqrt(TRANSIENT_GAIN)


@dataclass(frozen=True, slots=True)
class SensorClaim:
    """A sensor with this lag or dead time and a gain in this range, over a healthy sensor's."""

    column: int  # of the bank; behind its last one stands the sensor quicker than the model's
    hypothesis: Hypothesis
    gain_low: float
    gain_high: float
    fault: str  # "" is a sound sensor


@cache
def claims(config: ResponseConfig) -> tuple[SensorClaim, ...]:
    """Return every claim about the sensor, that of a sound and punctual one first."""
    least, top = config.gain_least, config.gain_max
    found = []
    # a sensor quicker than the training vehicle's; without it a dead time of one period of a
    # steady modulation explains such a sensor better than none
    quick = Hypothesis("", "healthy", "symmetric", 0.0, False)
    for column, each in enumerate((*build(config), quick)):
        if not each.beyond_limit:
            found.append(SensorClaim(column, each, config.gain_sound_min, top, ""))
            found.append(SensorClaim(column, each, least, config.gain_weak_max, "gain_low"))
        elif each.kind == "delay":
            found.append(SensorClaim(column, each, config.gain_weak_max, top, each.fault))
        else:
            found.append(SensorClaim(column, each, SLOW_LEAST, top, each.fault))
            if each.direction == "symmetric":
                found.append(SensorClaim(column, each, least, SLOW_LEAST, "transient"))
    return tuple(found)
