"""Decision rules on a window's mean: the paper's rule and the bias rule.

``paper_failed`` is the rule of *Model Based Diagnosis of Oxygen Sensors*. How the measurement
follows the prediction is judged in ``response``.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.config import BiasConfig
from monitor.judge.limits import Limits
from monitor.judge.window import Opinion, Outcome

MOST: Final = 256  # means of a drive that are kept
LEAST: Final = 8  # means that a line is laid through, or a step
EDGE: Final = 3  # means before a step and behind it, at least
RISE: Final = 5.0  # least rise of a drift over the drive, in standard deviations of a window


def paper_failed(mean: float, std: float, j_mu: float, j_sigma: float) -> bool:
    """Return the paper's verdict on a window of residuals: both limits reached."""
    return abs(mean) >= j_mu and std >= j_sigma


@dataclass(frozen=True, slots=True, kw_only=True)
class Bias(Opinion):
    """The finding of the bias rule after a window."""

    offset: float  # fading mean of the residual, output's unit
    offset_std: float | None = None  # its standard deviation
    beyond: float | None = None  # standard deviations outside the healthy offsets, below 0 inside


class Course:
    """The offsets of a drive so far, thinned out to at most ``MOST`` means."""

    def __init__(self) -> None:
        self._means: list[float] = []
        self._open: list[float] = []  # windows of the mean begun
        self._each = 1  # windows per mean

    def push(self, offset: float) -> None:
        """Add a window's offset."""
        self._open.append(offset)
        if len(self._open) < self._each:
            return
        self._means.append(math.fsum(self._open) / self._each)
        self._open = []
        if len(self._means) == MOST:
            self._means = np.mean(np.reshape(self._means, (-1, 2)), axis=1).tolist()
            self._each *= 2

    def drifts(self, window_std: float) -> bool:
        """Return whether a straight line describes the course, and neither a step nor a constant.

        window_std : of one window's offset
        The line must beat the best step by its squared error, and rise by more than the windows
        scatter.
        """
        n = len(self._means)
        if n < LEAST:
            return False
        y = np.array(self._means)
        t = np.arange(n) - 0.5 * (n - 1)
        slope = float(t @ y / (t @ t))
        line = float(np.square(y - y.mean() - slope * t).sum())
        sums, k = np.cumsum(y)[:-1], np.arange(1, n)
        step = float(np.square(y).sum() - (sums**2 / k + (y.sum() - sums) ** 2 / (n - k)).max())
        return abs(slope) * n > RISE * window_std and line < step

    def step(
        self, most: float, healthy: float, window_std: float, config: BiasConfig
    ) -> tuple[float, float]:
        """Return the surest step of the offset away from the healthy one, and how sure it is.

        most, healthy : size of a healthy step, healthy offset
        Sure is in standard deviations of the step's size, beyond ``most``. A window counts for no
        more than it would take to be a step alone, from the drive's median.
        """
        n = len(self._means)
        if n < LEAST or max(self._means) - min(self._means) <= most:
            return 0.0, -math.inf
        middle = float(np.median(self._means))
        alone = most + config.certainty * window_std
        sums = np.cumsum(np.clip(self._means, middle - alone, middle + alone))
        k, shared = np.arange(EDGE, n - EDGE + 1), config.variance_shared
        before, after = sums[k - 1] / k, (sums[-1] - sums[k - 1]) / (n - k)
        own = (1.0 - shared) / self._each * (1.0 / k + 1.0 / (n - k))
        sure = (np.abs(after - before) - most) / (window_std * np.sqrt(2.0 * shared + own))
        sure[np.abs(after - healthy) <= np.abs(before - healthy)] = -math.inf
        i = int(sure.argmax())
        return float(after[i] - before[i]), float(sure[i])


class BiasRule:
    """A fading mean of the windows' offsets against those that are healthy.

    It fails when the mean is outside them by ``certainty`` of its own standard deviations, so a
    large offset is found after few windows and a small one after many. A part of a window's
    deviation is shared by the whole drive and does not average out. A window counts for no more
    than it would take to fail alone, for a model may err by far in a single manoeuvre (bounded
    influence: Huber, Robust Statistics, chapter 4); the healthy limits are learned from windows
    that count for the same. The offset that is told is the plain mean.

    The mean remembers the time before a fault, so the rule also fails when the offset has stepped
    away within the drive, by ``certainty`` more than ``step_most`` (the likelihood ratio over all
    times of a change: Basseville and Nikiforov, Detection of Abrupt Changes, section 2.4).

    limits : with the healthy offsets and the spread of a window's
    step_most : largest step of a healthy offset within a drive, output's unit
    """

    def __init__(self, config: BiasConfig, limits: Limits, step_most: float = math.inf) -> None:
        self._config, self._step_most = config, step_most
        self._low, self._high, self._std = limits.offset_low, limits.offset_high, limits.offset_std
        self.windows, self.total = 0, 0.0  # that count, and the sum of their offsets
        self._course = Course()
        self._sum = self._bounded = self._weight = self._square = 0.0

    def judge(self, mean: float, *, ignore: bool = False) -> Bias:
        """Return the verdict after one more window; an ignored one is inconclusive."""
        config = self._config
        if not ignore:
            memory = config.memory
            alone = config.certainty * self._std  # with which a window would fail alone
            counted = min(max(mean, self._low - alone), self._high + alone)
            self.windows += 1
            self.total += mean
            self._course.push(mean)
            self._sum = memory * self._sum + mean
            self._bounded = memory * self._bounded + counted
            self._weight = memory * self._weight + 1.0
            self._square = memory**2 * self._square + 1.0
        if not self.windows:
            return Bias("inconclusive", offset=0.0)
        offset = self._sum / self._weight
        own = (1.0 - config.variance_shared) * self._square / self._weight**2
        std = self._std * math.sqrt(config.variance_shared + own)
        judged = self._bounded / self._weight
        beyond = max(judged - self._high, self._low - judged) / std
        outcome, fault = ("inconclusive", None) if ignore else self._verdict(judged, beyond)
        return Bias(outcome, fault, offset=offset, offset_std=std, beyond=beyond)

    def _verdict(self, offset: float, beyond: float) -> tuple[Outcome, str | None]:
        """Return outcome and fault after a window that counts."""
        config = self._config
        healthy = 0.5 * (self._low + self._high)
        # an offset may have begun within the drive
        step, sure = self._course.step(self._step_most, healthy, self._std, config)
        if sure > config.certainty:
            return "failed", self._named(is_lean=step > 0.0)
        if self.windows < config.n_windows or 0.0 <= beyond <= config.certainty:
            return "inconclusive", None
        if beyond < 0.0:
            return "passed", None
        return "failed", self._named(is_lean=offset > self._high)

    def _named(self, *, is_lean: bool) -> str:
        kind = "drift" if self._course.drifts(self._std) else "biased"
        return f"{kind}_{'lean' if is_lean else 'rich'}"
