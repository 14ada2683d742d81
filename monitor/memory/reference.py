"""What is healthy for this vehicle: offset and gain of its sensor against the model, learned.

Injectors, air meter and sensor differ from piece to piece, and fuel with ethanol burns with less
air, so a model of one vehicle is off by some percent on another. One drive shows the sum of both;
the fuel's part changes with every filling but stays within a known span, the vehicle's part does
not change. So every healthy drive narrows down where the vehicle can be (set-membership: Schweppe,
Uncertain Dynamic Systems, 1973), and an offset that no fuel explains is a fault.

The reference cannot hide a fault. A drive in which anything looked suspicious teaches nothing; the
offsets learned never span more than the fuel does, whatever the number of drives, so that a slow
drift leaves the span like a step does; the gain is learned from the first drives only and then
held.
"""

from dataclasses import dataclass, replace

from monitor.base.config import BiasConfig


@dataclass(frozen=True, slots=True)
class Seen:
    """What one healthy drive shows."""

    offset: float  # mean residual over the drive's windows, output's unit
    gain: float  # of the measurement over the prediction


@dataclass(frozen=True, slots=True)
class Reference:
    """The drives of one vehicle so far.

    >>> from monitor.base.config import load
    >>> bias = load().bias
    >>> two = Reference().learn(Seen(0.01, 1.0), bias).learn(Seen(0.03, 1.0), bias)
    >>> [round(edge, 3) for edge in two.offset_range(bias)]
    [-0.01, 0.05]
    """

    offset_low: float = 0.0  # of all drives, output's unit
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
        """Return the offsets that some fuel explains, lowest and highest; needs a drive."""
        span = config.fuel_span_lambda
        return self.offset_high - span, self.offset_low + span


def _bounded(gain: float, config: BiasConfig) -> float:
    return min(max(gain, 1.0 - config.gain_spread), 1.0 + config.gain_spread)
