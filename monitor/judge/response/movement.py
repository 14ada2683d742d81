"""Whether the reading moves at all: a dead sensor with noise, and one that holds now and then.

A sensor that is alive follows the mixture by at least the gain of the weakest sensor, so where the
prediction moves by more than its own error, the reading has at least that variance. A dead sensor
reads a constant and its own noise. The log likelihood ratio of the two variances is summed over
windows (Basseville and Nikiforov, Detection of Abrupt Changes, sections 2.2 and 4.3: change of a
variance, and a sum that is bounded so that a later death shows soon). Windows around fuel cuts add
to the same sum: there the mixture takes its largest steps.

A sensor that holds now and then repeats its last reading exactly for a second and more. A live one
does so only where its part of the mixture's movement stays within one step of its resolution; how
unlikely that is, follows from the prediction's movement and its error.
"""

from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.limits import Limits

DEAD: Final = "no_activity"
HOLDS: Final = "intermittent"


class Moved(NamedTuple):
    """The finding of the rule after a window."""

    fault: str | None  # that is decided
    dead: float  # log likelihood ratio of a dead sensor over a live one, summed
    holds: float  # the same of a sensor that holds now and then


class MovementRule:
    """Sequential test over windows, constant memory.

    limits : with the healthy residual's spread and memory
    period_s : of the samples
    """

    def __init__(self, config: Config, limits: Limits, period_s: float) -> None:
        own = self._config = config.movement
        self._noise_var, self._needed = limits.noise**2, config.response.evidence_fail
        self._quantum = 0.5 * config.plausibility.stuck_range
        self._independent = (1.0 - limits.noise_memory) / (1.0 + limits.noise_memory)
        self._hold = max(round(own.hold_s / period_s), own.hold_samples) - 1
        self._dead = self._holds = 0.0

    def judge(
        self,
        measured: FloatArray,
        healthy: FloatArray,
        no_evidence: BoolArray,
        *,
        is_cut: bool = False,
    ) -> list[Moved]:
        """Return the finding after each window.

        measured, healthy : (w, n) reading, and what a healthy sensor would read, like phi
        no_evidence : (w,) windows that count for nothing
        is_cut : windows around fuel cuts; in air a healthy reading, too, repeats itself, so they
            tell nothing of holds
        """
        needed, bound = self._needed, self._config.bound
        dead = self._dead_ratios(measured, healthy, is_cut=is_cut)
        holds = np.zeros(len(dead)) if is_cut else self._hold_ratios(measured, healthy)
        found = []
        # the sums count decisions: a window counts half of one at most, and halves do not round
        each = zip((dead / needed).tolist(), (holds / needed).tolist(), no_evidence, strict=True)
        for gone, held, skip in each:
            if not skip:
                self._dead = min(max(self._dead + gone, -1.0), bound)
                self._holds = min(max(self._holds + held, 0.0), bound)
            fault = DEAD if self._dead >= 1.0 else HOLDS if self._holds >= 1.0 else None
            found.append(Moved(fault, self._dead * needed, self._holds * needed))
        return found

    def _dead_ratios(
        self, measured: FloatArray, healthy: FloatArray, *, is_cut: bool
    ) -> FloatArray:
        """Return the log likelihood ratio of each window, (w,), limited to half a decision."""
        config, n, error_var = self._config, measured.shape[1], self._noise_var
        own = measured.var(axis=1)
        moves = np.maximum(healthy.var(axis=1) - config.error_share * error_var, 0.0)
        least = self._quantum**2
        least_alive = config.gain_least**2 * moves
        # around a fuel cut a sound reading may rest up to a step that it shows a little later
        moving = 0.0 if is_cut else least_alive
        most = config.still_share * np.maximum(error_var, moving)
        still = np.clip(own, least, np.maximum(most, least))
        alive = still + least_alive
        ratio = np.log(alive / still) - own * (1.0 / still - 1.0 / alive)
        most = 0.5 * self._needed
        return np.asarray(np.clip(0.5 * n * self._independent * ratio, -most, most))

    def _hold_ratios(self, measured: FloatArray, healthy: FloatArray) -> FloatArray:
        """Return the evidence of the longest hold of each window, (w,)."""
        same = measured[:, 1:] == measured[:, :-1]
        place = np.arange(same.shape[1])
        length = place - np.maximum.accumulate(np.where(same, -1, place), axis=1)
        longest, end = length.max(axis=1), length.argmax(axis=1) + 1
        is_hold = (longest >= self._hold) & (longest < same.shape[1])
        moves = healthy.var(axis=1) > self._config.error_share * self._noise_var
        none = np.where(moves, -self._config.no_hold, 0.0)
        if not is_hold.any():
            return none
        at = np.arange(measured.shape[1])
        inside = (at >= (end - longest)[:, np.newaxis]) & (at <= end[:, np.newaxis])
        step = np.where(same, np.inf, np.abs(np.diff(measured, axis=1))).min(axis=1)
        high = np.where(inside, healthy, -np.inf).max(axis=1)
        low = np.where(inside, healthy, np.inf).min(axis=1)
        beyond = np.maximum(self._config.gain_least * (high - low) - step, 0.0)
        unlikely = np.minimum(beyond**2 / (4.0 * self._noise_var), 0.5 * self._needed)
        return np.where(is_hold, unlikely, none)
