"""The downstream sensor against a switching front sensor: does the rear follow every excursion?

A front sensor that only switches tells no amount of oxygen, so no capacity follows. But behind an
empty can, or none, the rear sensor repeats what the front sensor does; behind a catalyst that
stores, short excursions of the mixture never reach it. Every short excursion of the front sensor,
away from the side on which the rear sensor stands, is one trial: the rear follows or it does not.
The trials are compared with the probabilities of both claims by the sequential test of the response
rule (Wald, Sequential Analysis, section 3.2). Fuel cuts and long excursions are no trials: they
fill or empty any catalyst. A rear sensor that has stood on one side only may be dead, so it passes
nothing.
"""

import math
from dataclasses import dataclass

from monitor.base.config import Config
from monitor.judge.catalyst.bank import MID_V
from monitor.judge.catalyst.rule import CATALYST, Claim, claim_of

LEAN, RICH, BETWEEN = -1, 1, 0


@dataclass(slots=True)
class _Excursion:
    """The front sensor is on one side, and the rear sensor began on the other."""

    side: int
    begin_s: float
    end_s: float = math.inf
    is_followed: bool = False


class RearActivity:
    """Counts excursions of the front sensor that the rear follows; samples come one by one."""

    def __init__(self, settings: Config) -> None:
        self._config, self._odds = settings.catalyst, settings.response
        follows = self._config.follow_low
        self._gain = math.log(follows / (1.0 - follows))  # of a trial, for or against
        self._front = self._rear = BETWEEN
        self._open: list[_Excursion] = []
        self._last_s = -math.inf
        self._shown: set[int] = set()  # sides on which the rear sensor has stood
        self.log_odds = 0.0  # of a catalyst that stores nothing, over a sound one
        self.trials = self.followed = 0

    def push(self, t_s: float, front_v: float, rear_v: float, *, burning: bool) -> bool:
        """Take one sample; return whether a trial ended.

        A pause above ``follow_late_s``, an unknown value and a fuel cut end all trials untold.
        """
        config, trials = self._config, self.trials
        known = math.isfinite(front_v) and math.isfinite(rear_v)
        if not known or t_s - self._last_s > config.follow_late_s:
            self._front = self._rear = BETWEEN
            self._open.clear()
        self._last_s = t_s
        if not known:
            return False
        self._rear = _side(self._rear, rear_v, config.awake_v)
        self._shown.add(self._rear)
        before, self._front = self._front, _side(self._front, front_v, config.awake_v)
        if self._front != before:
            for each in self._open:
                each.end_s = min(each.end_s, t_s)
            if before != BETWEEN and self._rear == -self._front:
                self._open.append(_Excursion(self._front, t_s))
        if not burning:
            self._open.clear()
        for each in self._open:
            each.is_followed |= self._rear == each.side
        # those that are over for longer than the rear sensor may be late
        for each in [e for e in self._open if t_s > e.end_s + config.follow_late_s]:
            self._open.remove(each)
            if each.end_s - each.begin_s <= config.follow_longest_s:
                self.trials += 1
                self.followed += each.is_followed
                self.log_odds += self._gain if each.is_followed else -self._gain
        self.log_odds = min(max(self.log_odds, -config.evidence_most), config.evidence_most)
        return self.trials > trials

    @property
    def shows_both_sides(self) -> bool:
        """Return whether the rear sensor has stood on the lean and on the rich side."""
        return {LEAN, RICH} <= self._shown

    def claim(self) -> Claim:
        """Return how the evidence stands for a catalyst that stores nothing."""
        claim = claim_of(self.log_odds, CATALYST, self._odds)
        may_be_dead = claim.outcome == "passed" and not self.shows_both_sides
        return Claim(log_odds=self.log_odds) if may_be_dead else claim


def _side(before: int, volts: float, hysteresis_v: float) -> int:
    """Return the side of a switching sensor; between the thresholds it stays."""
    if volts > MID_V + hysteresis_v:
        return RICH
    return LEAN if volts < MID_V - hysteresis_v else before
