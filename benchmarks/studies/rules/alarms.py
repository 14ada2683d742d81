"""Compare decision rules on whole drives: the monitor's two scores and the rules of the literature.

The monitor's debounce wants two failed windows in a row. So the score of a drive is the largest
value that two successive windows both reach, and a drive alarms if two successive windows alarm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.studies.rules import RULES, PaperRule, Windows
from benchmarks.studies.rules.windows import Rule
from monitor.base.types import FloatArray
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import Limits
from training.limits.judging import reached_twice

FALSE_ALARM_RATE: Final = 0.01  # per healthy window of the calibration drives
OWN: Final = ("response", "bias")
TITLES: Final = {
    "response": "monitor, response",
    "bias": "monitor, bias",
    "paper_card": "paper's rule, limits of the card",
    "PaperRule": "paper's rule, limits on faulty drives",
    "FuzzyRule": "fuzzy clusters",
    "DifferencesRule": "differences",
    "AdaptiveThreshold": "adaptive threshold",
}


@dataclass(frozen=True, slots=True)
class Scored:
    """Verdict of one rule on one drive."""

    score: float | None  # None for a drive with fewer than two windows
    alarm: int | None  # index of the second of the first two successive windows that alarm
    failed: int  # number of windows that alarm

    @classmethod
    def of(cls, scores: FloatArray, failed: np.ndarray) -> "Scored":
        """Return the verdict on a drive from the scores and verdicts of its windows, both (n,)."""
        best = np.minimum(scores[1:], scores[:-1]).max(initial=-np.inf)
        twice = np.flatnonzero(failed[1:] & failed[:-1])
        return cls(
            float(best) if np.isfinite(best) else None,
            int(twice[0]) + 1 if len(twice) else None,
            int(failed.sum()),
        )


def fitted(
    good: Sequence[Sequence[WindowJudged]], bad: Sequence[Sequence[WindowJudged]], limits: Limits
) -> dict[str, Rule]:
    """Return the rules of the literature, name → rule, set on calibration drives.

    good, bad : windows of healthy drives and of drives with a fault, one list per drive
    limits : limits of the paper's rule named ``paper_card``
    Raises RecordingError if the drives hold too few windows.
    """
    healthy, faulty = Windows.of(good), Windows.of(bad)
    rules: dict[str, Rule] = {"paper_card": PaperRule(limits.j_mu, limits.j_sigma)}
    return rules | {r.__name__: r.fit(healthy, faulty, FALSE_ALARM_RATE) for r in RULES}


def drive_scores(windows: Sequence[WindowJudged], rules: dict[str, Rule]) -> dict[str, Scored]:
    """Return the verdict of every rule on one drive, name of the rule → verdict."""
    if not windows:
        return dict.fromkeys(rules, Scored(None, None, 0))
    drive = Windows.of([windows])
    return {name: Scored.of(rule.score(drive), rule.faulty(drive)) for name, rule in rules.items()}


def own_scores(windows: Sequence[WindowJudged]) -> dict[str, float | None]:
    """Return the scores of a drive by the monitor's two rules, ``response`` and ``bias``.

    ``response`` is the evidence for a faulty sensor. ``bias`` is the distance of the offset from
    the healthy range of the vehicle in standard deviations, negative inside the range.
    """
    return {
        "response": reached_twice(windows, "evidence"),
        "bias": reached_twice(windows, "offset_beyond"),
    }
