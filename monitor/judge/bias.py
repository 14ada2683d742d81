"""Decision rules on a window's mean: the paper's rule and the bias rule.

``paper_failed`` is the rule of *Model Based Diagnosis of Oxygen Sensors*. How the measurement
follows the prediction is judged in ``response``.
"""

import math
from dataclasses import dataclass

from monitor.base.config import BiasConfig
from monitor.judge.response import Outcome


def paper_failed(mean: float, std: float, j_mu: float, j_sigma: float) -> bool:
    """Return the paper's verdict on a window of residuals: both limits reached."""
    return abs(mean) >= j_mu and std >= j_sigma


@dataclass(frozen=True, slots=True)
class Bias:
    """What the bias rule says after a window."""

    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    offset: float  # fading mean of the residual, output's unit
    offset_std: float | None = None  # its standard deviation
    beyond: float | None = None  # standard deviations outside the healthy offsets, below 0 inside


class BiasRule:
    """A fading mean of the residual against the offsets that are healthy.

    It fails when the mean is outside them by ``certainty`` of its own standard deviations, so a
    large offset is found after few windows and a small one after many. A part of a window's
    deviation is shared by the whole drive and does not average out.

    low, high : healthy offsets, output's unit
    window_std : of one window's mean, output's unit
    """

    def __init__(self, config: BiasConfig, low: float, high: float, window_std: float) -> None:
        self._config = config
        self._low, self._high, self._window_std = low, high, window_std
        self.reset()

    def reset(self) -> None:
        """Forget the windows seen."""
        self._windows = 0
        self._sum = self._weight = self._square = 0.0

    def judge(self, mean: float, *, ignore: bool = False) -> Bias:
        """Return the verdict after one more window; an ignored one is inconclusive."""
        config = self._config
        if not ignore:
            memory = config.memory
            self._windows += 1
            self._sum = memory * self._sum + mean
            self._weight = memory * self._weight + 1.0
            self._square = memory**2 * self._square + 1.0
        if not self._windows:
            return Bias("inconclusive", None, (), 0.0)
        offset = self._sum / self._weight
        own = (1.0 - config.variance_shared) * self._square / self._weight**2
        std = self._window_std * math.sqrt(config.variance_shared + own)
        beyond = max(offset - self._high, self._low - offset) / std
        if ignore or self._windows < config.n_windows or 0.0 <= beyond <= config.certainty:
            return Bias("inconclusive", None, (), offset, std, beyond)
        if beyond < 0.0:
            return Bias("passed", None, (), offset, std, beyond)
        fault = "biased_lean" if offset > self._high else "biased_rich"
        return Bias("failed", fault, (), offset, std, beyond)
