"""Decision rules from the literature, for comparison with the monitor's own.

Every rule is fitted with ``fit(healthy, faulty, false_alarm_rate)`` and then gives
``score(windows)``, larger is more faulty, for ROC curves, and ``faulty(windows)``, (n,) bool.
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
