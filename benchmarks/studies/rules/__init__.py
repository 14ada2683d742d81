"""Decision rules of the literature, for comparison with the rules of the monitor.

``fit(healthy, faulty, false_alarm_rate)`` sets a rule. ``score(windows)`` returns (n,) scores for
ROC curves, larger is more faulty; ``faulty(windows)`` returns the verdicts, (n,) bool.
"""

from benchmarks.studies.rules.adaptive import AdaptiveThreshold
from benchmarks.studies.rules.differences import DifferencesRule
from benchmarks.studies.rules.fuzzy import FuzzyRule
from benchmarks.studies.rules.paper import PaperRule
from benchmarks.studies.rules.windows import Rule, Windows

RULES: tuple[type[Rule], ...] = (PaperRule, FuzzyRule, DifferencesRule, AdaptiveThreshold)

__all__ = [
    "RULES",
    "AdaptiveThreshold",
    "DifferencesRule",
    "FuzzyRule",
    "PaperRule",
    "Rule",
    "Windows",
]
