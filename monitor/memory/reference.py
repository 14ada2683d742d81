"""The vehicle's healthy reference: offset and gain of its sensor against the model, learned.

Injectors, air meter and sensor differ from piece to piece, and fuel with ethanol needs less air.
A model of one vehicle is therefore off by some percent on another. A drive shows the sum of both
offsets. The fuel's part changes with every filling but has a known span; the vehicle's part is
constant. Every healthy drive thus narrows the range of the vehicle's part (set-membership:
Schweppe, Uncertain Dynamic Systems, 1973), and an offset that no fuel explains is a fault.

The reference cannot hide a fault. A suspicious drive does not change it. The span of the learned
offsets never exceeds the fuel's span, so a slow drift leaves it as a step does. The gain is
learned from the first drives only and is then fixed.
"""

from dataclasses import dataclass, replace

from monitor.base.config import BiasConfig


@dataclass(frozen=True, slots=True)
class Seen:
    """Offset and gain of one healthy drive."""

    offset: float  # mean residual over the drive's windows, in the output's unit
    gain: float  # measurement over prediction


@dataclass(frozen=True, slots=True)
class Reference:
    """Range of offsets and mean gain over the healthy drives of one vehicle.

    >>> from monitor.base.config import load
    >>> bias = load().bias
    >>> two = Reference().learn(Seen(0.01, 1.0), bias).learn(Seen(0.03, 1.0), bias)
    >>> [round(edge, 3) for edge in two.offset_range(bias)]
    [-0.01, 0.05]
    """

    offset_low: float = 0.0  # over all drives, in the output's unit
    offset_high: float = 0.0
    gain: float = 1.0
    drives: int = 0

    def learn(self, seen: Seen, config: BiasConfig) -> "Reference":
        """Return the reference after one more healthy drive."""
        if self.drives == 0:
            return Reference(seen.offset, seen.offset, _bounded(seen.gain, config), 1)
        lowest, highest = self.offset_range(config)
        grown = replace(
            self,
            offset_low=min(self.offset_low, max(seen.offset, lowest)),
            offset_high=max(self.offset_high, min(seen.offset, highest)),
            drives=self.drives + 1,
        )
        if grown.drives <= config.gain_drives:
            gain = self.gain + (seen.gain - self.gain) / grown.drives
            grown = replace(grown, gain=_bounded(gain, config))
        return grown

    def offset_range(self, config: BiasConfig) -> tuple[float, float]:
        """Return the lowest and highest offset that some fuel explains; needs a drive."""
        span = config.fuel_span_lambda
        return self.offset_high - span, self.offset_low + span


def _bounded(gain: float, config: BiasConfig) -> float:
    return min(max(gain, 1.0 - config.gain_spread), 1.0 + config.gain_spread)
