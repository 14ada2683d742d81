"""The evidence about each fault of the response test, in words, and the time until a decision."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from monitor.base.counts import duration
from monitor.report.words import amount

DECIDED: Final = ("found", "excluded")


def rows(recording: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return each fault, its evidence, and what a decision still needs, the nearest fault first.

    >>> near = {"log_odds": -4.6, "needed": 9.21, "seconds_to_decision": 25.0}
    >>> far = {"log_odds": -9.3, "needed": 9.21, "seconds_to_decision": 0.0}
    >>> none = {"log_odds": 0.0, "needed": 9.21, "seconds_to_decision": None}
    >>> evidence = {"transient": far, "gain_low": near, "slow_symmetric": none}
    >>> for row in rows({"evidence": evidence}):
    ...     print(*row, sep=": ")
    slow_symmetric: no evidence yet: no time can be told yet
    gain_low: against it 50 % of the evidence a decision needs: about 25 s more
    transient: against it 1.0 times the evidence a decision needs: excluded
    """
    evidence: Mapping[str, Mapping[str, Any]] = recording.get("evidence") or {}
    known = [(v["log_odds"], k) for k, v in evidence.items() if v["log_odds"] is not None]
    found = [_row(fault, evidence[fault]) for _, fault in sorted(known, reverse=True)]
    if recording.get("fault_flag"):  # the drive has its answer
        return [(fault, words, left if left in DECIDED else "–") for fault, words, left in found]
    return found


def undecided(recording: Mapping[str, Any]) -> Iterator[str]:
    """Yield the faults that are not decided, those with the same evidence on one line.

    >>> none = {"log_odds": 0.0, "needed": 9.21, "seconds_to_decision": None}
    >>> list(undecided({"evidence": {"gain_low": none, "transient": none}}))
    ['transient, gain_low: no evidence yet; no time can be told yet']
    """
    alike: dict[str, list[str]] = {}
    for fault, words, left in rows(recording):
        if left not in DECIDED:
            alike.setdefault(f"{words}; {left}", []).append(fault)
    yield from (f"{', '.join(faults)}: {words}" for words, faults in alike.items())


def _row(fault: str, each: Mapping[str, Any]) -> tuple[str, str, str]:
    if not each["log_odds"]:
        return fault, "no evidence yet", "no time can be told yet"
    side, decided = ("for", "found") if each["log_odds"] > 0.0 else ("against", "excluded")
    left_s = each["seconds_to_decision"]
    left = "no time can be told" if left_s is None else f"about {duration(left_s)} more"
    if abs(each["log_odds"]) >= each["needed"]:
        left = decided
    return fault, f"{side} it {amount(each)}", left.replace("\u00a0", " ")
