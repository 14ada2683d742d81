"""The evidence about each fault of the response test, in words, and the time until a decision."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from monitor.report.words import duration, needed, odds

DECIDED: Final = ("found", "excluded")


def rows(recording: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return each fault, its odds, and what a decision still needs; the nearest to a fault first.

    >>> near = {"log_odds": -4.6, "needed": 9.21, "seconds_to_decision": 25.0}
    >>> far = {"log_odds": -9.3, "needed": 9.21, "seconds_to_decision": 0.0}
    >>> none = {"log_odds": 0.0, "needed": 9.21, "seconds_to_decision": None}
    >>> evidence = {"transient": far, "gain_low": near, "slow_symmetric": none}
    >>> for row in rows({"evidence": evidence}):
    ...     print(*row, sep=": ")
    slow_symmetric: no evidence yet, odds of 10⁴ to 1 are needed: no time can be told yet
    gain_low: against it 10² to 1, 10⁴ to 1 are needed: about 25 s more
    transient: against it 10⁴ to 1, 10⁴ to 1 are needed: excluded
    """
    evidence: Mapping[str, Mapping[str, Any]] = recording.get("evidence") or {}
    known = [(v["log_odds"], k) for k, v in evidence.items() if v["log_odds"] is not None]
    return [_row(fault, evidence[fault]) for _, fault in sorted(known, reverse=True)]


def undecided(recording: Mapping[str, Any]) -> Iterator[str]:
    """Yield the faults that are not decided, those with the same evidence on one line.

    >>> none = {"log_odds": 0.0, "needed": 9.21, "seconds_to_decision": None}
    >>> list(undecided({"evidence": {"gain_low": none, "transient": none}}))
    ['transient, gain_low: no evidence yet, odds of 10⁴ to 1 are needed; no time can be told yet']
    """
    alike: dict[str, list[str]] = {}
    for fault, words, left in rows(recording):
        if left not in DECIDED:
            alike.setdefault(f"{words}; {left}", []).append(fault)
    yield from (f"{', '.join(faults)}: {words}" for words, faults in alike.items())


def _row(fault: str, each: Mapping[str, Any]) -> tuple[str, str, str]:
    if not each["log_odds"]:
        return fault, f"no evidence yet, {needed(each)}", "no time can be told yet"
    side, decided = ("for", "found") if each["log_odds"] > 0.0 else ("against", "excluded")
    left_s = each["seconds_to_decision"]
    left = "no time can be told" if left_s is None else f"about {duration(left_s)} more"
    if abs(each["log_odds"]) >= each["needed"]:
        left = decided
    return fault, f"{side} it {odds(each)}", left.replace("\u00a0", " ")
