"""What windows say, before anything is decided: the response rule, its offset, and movement."""

import math
from collections.abc import Sequence
from itertools import groupby
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np

from monitor.base.config import Config
from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from monitor.judge.response.movement import Moved, MovementRule
from monitor.judge.response.rule import Response, ResponseRule
from monitor.judge.window import Window, lambda_of
from monitor.memory.codes import CODES
from monitor.model.card import ModelCard

LAMBDA_LEAST: Final = 0.1  # what stays of a measurement whose offset is taken off


class Facts(NamedTuple):
    """The findings of a window, before a decision."""

    mean: float  # of the residual, output's unit; around fuel cuts oriented like phi
    std: float
    no_evidence: bool  # the measurement does not move
    offset: float  # mean of the measurement against the likeliest sensor, output's unit
    response: Response
    moved: Moved


class Evidence(NamedTuple):
    """How far the response test is from a decision about one fault."""

    log_odds: float  # of the fault over all that is no fault
    needed: float  # log odds, or their negative where they are below 0, that decide
    seconds_to_decision: float | None  # of enabled driving like that so far, None if it shows none


class WindowFacts:
    """The facts of one driving cycle's windows, and the evidence that they sum up to."""

    def __init__(self, limits: Limits, config: Config, card: ModelCard) -> None:
        self._transform, period_s = card.transform, card.period_ns * 1e-9
        self._range_end = card.output.maximum
        self._config = config.response
        self._stuck_range = config.plausibility.stuck_range
        self._window_s = config.window.n_samples * period_s
        self.response = ResponseRule(config.response, limits, period_s)
        self._n_cuts = 0  # windows around fuel cuts
        self._movement = MovementRule(config, limits, period_s)

    def of(self, windows: Sequence[Window]) -> list[Facts]:
        """Return the facts of windows that follow each other; each goes through once.

        The edges of fuel cuts are judged by the same claims, and their evidence is the same.
        """
        kinds = groupby(windows, attrgetter("is_cut"))
        return [each for is_cut, own in kinds for each in self._of_kind(list(own), is_cut=is_cut)]

    def evidence(self) -> dict[str, Evidence]:
        """Return how far the response test is from a decision about each fault.

        The time left supposes that the evidence goes on to grow as it did so far.
        """
        rule, config = self.response, self._config
        # a window around a fuel cut has half the samples
        seconds = (rule.windows - 0.5 * self._n_cuts) * self._window_s
        found = {}
        for fault, odds in rule.odds.items():
            needed = config.evidence_fail if odds > 0.0 else config.evidence_pass
            missing = max(needed - abs(odds), 0.0)
            left = missing / abs(odds) * seconds if odds else None
            found[fault] = Evidence(odds, needed, left)
        return found

    def probability(self, fault: str) -> float:
        """Return the probability of a fault's name among the names with the same code."""
        odds = self.response.odds
        if fault not in odds:
            return 1.0
        alike = [value for name, value in odds.items() if CODES[name] == CODES[fault]]
        return math.exp(odds[fault] - max(alike)) / sum(math.exp(v - max(alike)) for v in alike)

    def _of_kind(self, windows: Sequence[Window], *, is_cut: bool) -> list[Facts]:
        measured = np.array([window.measured for window in windows])
        phi, banks = phi_of(windows, self._transform), [window.bank for window in windows]
        healthy = np.array([bank[:, 0] for bank in banks])
        residual = phi - healthy if is_cut else np.array([window.residual for window in windows])
        low, high = measured.min(axis=1), measured.max(axis=1)
        ignore = high - low <= self._stuck_range  # it stands still: for the activity test
        responses = self.response.judge(phi, banks, ignore)
        self._n_cuts += is_cut * int(np.count_nonzero(~ignore))
        offset = np.zeros(len(windows)) if is_cut else self._offset(measured, banks, responses)
        in_air = is_cut & (low >= self._range_end - self._stuck_range)
        moved = self._movement.judge(phi, healthy, ignore | in_air, is_cut=is_cut)
        each = residual.mean(axis=1), residual.std(axis=1), ignore, offset
        return list(map(Facts, *(column.tolist() for column in each), responses, moved))

    def _offset(
        self, measured: FloatArray, banks: Sequence[FloatArray], responses: Sequence[Response]
    ) -> FloatArray:
        """Return each window's median of the measurement against the likeliest sensor, (w,).

        A sensor slow or late on one edge rectifies the modulation, which shifts its mean; a few
        readings that jump to an end of the range shift no median.
        """
        likeliest = [bank[:, each.column] for bank, each in zip(banks, responses, strict=True)]
        beside = measured - lambda_of(np.array(likeliest), self._transform)
        return np.asarray(np.median(beside, axis=1))


def phi_of(windows: Sequence[Window], transform: str) -> FloatArray:
    """Return the measurements of windows of one kind, (w, n), like phi, as the rules see them.

    An offset in lambda would change the gain in phi: around fuel cuts it hardly does.
    """
    measured = np.array([window.measured for window in windows])
    if not windows[0].is_cut:
        measured -= np.array([window.residual.mean() for window in windows])[:, np.newaxis]
    return np.asarray(1.0 / np.maximum(measured, LAMBDA_LEAST)) if transform == "phi" else -measured
