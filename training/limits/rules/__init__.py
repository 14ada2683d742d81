"""Decision rules from the literature, to compare with the monitor's rules.

A rule is fitted with ``fit(healthy, faulty, false_alarm_rate)``. Then ``score(windows)`` returns
scores for ROC curves, larger for more faulty, and ``faulty(windows)`` verdicts, both (n,).
"""

from training.limits.rules.adaptive import AdaptiveThreshold
from training.limits.rules.differences import DifferencesRule
from training.limits.rules.fuzzy import FuzzyRule
from training.limits.rules.paper import PaperRule
from training.limits.rules.windows import Rule, Windows

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
