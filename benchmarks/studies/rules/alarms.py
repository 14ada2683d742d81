"""Alarms of the literature's rules on whole drives.

The monitor's debounce wants two failed windows in a row, so a drive alarms if two successive
windows alarm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.studies.rules.adaptive import AdaptiveThreshold
from benchmarks.studies.rules.differences import DifferencesRule
from benchmarks.studies.rules.fuzzy import FuzzyRule
from benchmarks.studies.rules.paper import PaperRule
from benchmarks.studies.rules.windows import Rule, Windows
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import Limits

FALSE_ALARM_RATE: Final = 0.01  # per healthy window of the calibration drives
RULES: Final[tuple[type[Rule], ...]] = (PaperRule, FuzzyRule, DifferencesRule, AdaptiveThreshold)
TITLES: Final = {
    "paper_card": "paper's rule, limits of the card",
    "PaperRule": "paper's rule, limits on faulty drives",
    "FuzzyRule": "fuzzy clusters",
    "DifferencesRule": "differences",
    "AdaptiveThreshold": "adaptive threshold",
}


@dataclass(frozen=True, slots=True)
class Alarms:
    """Windows of a drive in which a rule alarms."""

    failed: int  # number of windows
    second: int | None  # index of the second of the first two successive ones

    @classmethod
    def of(cls, failed: np.ndarray) -> "Alarms":
        """Return the alarms of a drive from the verdicts on its windows, (n,) bool."""
        twice = np.flatnonzero(failed[1:] & failed[:-1])
        return cls(int(failed.sum()), int(twice[0]) + 1 if len(twice) else None)


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


def alarms(windows: Sequence[WindowJudged], rules: Mapping[str, Rule]) -> dict[str, Alarms]:
    """Return the alarms of every rule on one drive, by the rule's name."""
    if not windows:
        return dict.fromkeys(rules, Alarms(0, None))
    drive = Windows.of([windows])
    return {name: Alarms.of(rule.faulty(drive)) for name, rule in rules.items()}
