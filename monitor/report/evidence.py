"""The evidence about each fault of the response test, in words, and the time until a decision."""

from collections.abc import Mapping
from typing import Any, Final

from monitor.report.words import duration, odds

DECIDED: Final = ("found", "excluded")


def rows(recording: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return each fault, its odds, and what a decision still needs; the nearest to a fault first.

    >>> near = {"log_odds": -4.6, "needed": 9.21, "seconds_to_decision": 25.0}
    >>> far = {"log_odds": -9.3, "needed": 9.21, "seconds_to_decision": 0.0}
    >>> for row in rows({"evidence": {"transient": far, "gain_low": near}}):
    ...     print(*row, sep=": ")
    gain_low: against it 10² to 1, 10⁴ to 1 are needed: about 25 s more
    transient: against it 10⁴ to 1, 10⁴ to 1 are needed: excluded
    """
    evidence: Mapping[str, Mapping[str, Any]] = recording.get("evidence") or {}
    known = [(v["log_odds"], k) for k, v in evidence.items() if v["log_odds"] is not None]
    return [_row(fault, evidence[fault]) for _, fault in sorted(known, reverse=True)]


def _row(fault: str, each: Mapping[str, Any]) -> tuple[str, str, str]:
    side, decided = ("for", "found") if each["log_odds"] > 0.0 else ("against", "excluded")
    left_s = each["seconds_to_decision"]
    left = "no evidence for or against it" if left_s is None else f"about {duration(left_s)} more"
    if abs(each["log_odds"]) >= each["needed"]:
        left = decided
    return fault, f"{side} it {odds(each)}", left.replace("\u00a0", " ")
