"""What is known behind the catalyst, in words, for the report and the live page."""

from collections.abc import Mapping
from typing import Any, Final

from monitor.base.counts import plain
from monitor.memory.codes import TEST_OF

LOG_ODDS: Final = {  # of each test
    "catalyst": "log_odds",
    "downstream": "sensor_log_odds",
    "balance": "balance_log_odds",
}


def evidence(recording: Mapping[str, Any], fault: str) -> dict[str, float] | None:
    """Return the evidence for a fault behind the catalyst, None if its test has no odds.

    >>> low = {"catalyst": {"log_odds": 12.0, "needed": 9.21}}
    >>> evidence(low, "catalyst_low")
    {'log_odds': 12.0, 'needed': 9.21}
    """
    entry: Mapping[str, float] = recording.get("catalyst") or {}
    key = LOG_ODDS.get(TEST_OF.get(fault, ""), "")
    return {"log_odds": entry[key], "needed": entry["needed"]} if key in entry else None


def rows(entry: Mapping[str, Any] | None) -> list[list[str]]:
    """Return names and texts of an entry of ``catalyst``; nothing without a downstream voltage."""
    if entry is None:
        return []
    if entry.get("method") == "activity":
        followed = f"the rear sensor followed {entry['followed']} of {entry['trials']} excursions"
        return [["catalyst", f"{entry['verdict']}: {followed} of the front sensor"]]
    if entry["capacity_g"] is None:
        return [["behind the catalyst", "no evidence yet"]]
    offset, std = entry["upstream_offset_lambda"], entry["upstream_offset_std"]
    return [
        ["catalyst stores", f"{_capacity(entry)}, threshold {plain(entry['threshold_g'], 2)} g"],
        ["catalyst", entry["verdict"]],
        ["downstream sensor", entry["sensor_verdict"]],
        ["oxygen balance", entry["balance_verdict"]],
        ["upstream offset", f"{offset:+.4f} ± {std:.4f}".replace("-", "−")],
    ]


def _capacity(entry: Mapping[str, Any]) -> str:
    low, high = entry["capacity_low_g"], entry["capacity_high_g"]
    if high is None:
        return f"at least {plain(low, 2)} g"
    return f"{plain(entry['capacity_g'], 2)} g ({plain(low, 2)} to {plain(high, 2)} g)"
