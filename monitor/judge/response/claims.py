"""Claims about the sensor: its lag or dead time, and the range of its gain."""

from dataclasses import dataclass
from functools import cache

from monitor.base.config import ResponseConfig
from monitor.judge.response.bank import Hypothesis

UNRELATED = "unrelated"  # the prediction says nothing of the measurement: neither sound nor a fault


@dataclass(frozen=True, slots=True)
class Noise:
    """The healthy residual within windows, oriented like phi, as a first-order process."""

    std: float
    memory: float  # correlation of neighbouring samples, 0 to below 1

    @property
    def innovation_var(self) -> float:
        """Return the variance of the new part of each sample."""
        return self.std**2 * (1.0 - self.memory**2)


@dataclass(frozen=True, slots=True)
class SensorClaim:
    """A sensor with this lag or dead time and a gain in this range."""

    column: int  # of the bank; behind its last one stands the sensor quicker than the model's
    hypothesis: Hypothesis
    gain_low: float
    gain_high: float
    fault: str  # "" is a sound sensor, UNRELATED none at all


@cache
def claims(config: ResponseConfig, bank: tuple[Hypothesis, ...]) -> tuple[SensorClaim, ...]:
    """Return every claim about the sensor, the healthy one first."""
    least, top = config.gain_least, config.gain_max
    found = []
    # a sensor quicker than the training vehicle's; without it a dead time of one period of a
    # steady modulation explains such a sensor better than none
    quick = Hypothesis("", "healthy", "symmetric", 0.0, False)
    for column, each in enumerate((*bank, quick)):
        if not each.beyond_limit:
            found.append(SensorClaim(column, each, config.gain_sound_min, top, ""))
            found.append(SensorClaim(column, each, least, config.gain_weak_max, "gain_low"))
        elif each.kind == "delay":
            found.append(SensorClaim(column, each, config.gain_weak_max, top, each.fault))
        else:
            found.append(SensorClaim(column, each, config.gain_slow_min, top, each.fault))
            if each.direction == "symmetric":
                weak = config.gain_slow_min
                found.append(SensorClaim(column, each, least, weak, "transient"))
    found.append(SensorClaim(len(bank), quick, 0.0, 0.0, UNRELATED))
    return tuple(found)
