"""Decision rules of plug-ins, beside the monitor's own.

A plug-in brings a rule by the entry point ``o2_monitor.rules``: its name is the rule's, its object
a class. The settings switch it on: ``[rules] active = ["NAME"]``. An instance judges the windows of
one driving cycle; its opinions pass through the same debounce as those of the response test, and
set codes of the manufacturer's range.
"""

from collections.abc import Mapping
from functools import cache
from typing import ClassVar, Final, Protocol, get_args

from monitor.base.errors import ConfigError, O2Error
from monitor.base.foreign import ForeignError, foreign, returned
from monitor.judge.window import Opinion, Outcome, Window
from monitor.memory.codes import admit

GROUP: Final = "o2_monitor.rules"


class Rule(Protocol):
    """Judges the windows of one driving cycle, in their order."""

    faults: ClassVar[Mapping[str, str]]  # fault: its code, P1000 to P1FFF

    def judge(self, window: Window) -> Opinion:
        """Take a full window of enabled samples; return the finding of all windows so far."""


RuleClass = type[Rule]


@cache
def loaded(name: str) -> RuleClass:
    """Return a rule's class, with its faults known to the fault memory.

    Raises ConfigError if there is no such rule or it cannot be used.
    """
    from importlib.metadata import entry_points  # noqa: PLC0415 - slow, and few have plug-ins

    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        raise ConfigError(f"[rules] {name}: no such rule; installed are {sorted(points) or 'none'}")
    try:
        rule: RuleClass = returned(points[name].value, points[name].load, type)
        with foreign(points[name].value):
            faults = dict(rule.faults)
        admit(name, faults)
    except O2Error as error:
        raise ConfigError(f"[rules] {name}: {error}") from error
    return rule


def opinion(name: str, rule: Rule, window: Window) -> Opinion:
    """Return the finding of a rule on a window.

    Raises ForeignError if the rule fails, or says something else than one of its faults or none.
    """
    said = returned(name, lambda: rule.judge(window), Opinion)
    with foreign(name):
        named = {said.fault, *said.also} if said.outcome == "failed" else set()
        known = said.outcome in get_args(Outcome) and named <= set(rule.faults)
    if not known:
        raise ForeignError(f"{name} fails: {said} is no finding on its faults")
    return said
