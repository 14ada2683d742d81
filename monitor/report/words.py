"""The words of the report: meanings of faults, verdicts, numbers with their units; no HTML."""

import math
from collections.abc import Mapping
from typing import Any, Final

from monitor.report import catalyst

_SUPERSCRIPT: Final = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_PLAIN: Final = 30.0  # odds below it are written out
MEANINGS = {
    "slow_rich_to_lean": "slow on rich-to-lean edges",
    "slow_lean_to_rich": "slow on lean-to-rich edges",
    "slow_symmetric": "slow on both edges",
    "delay_rich_to_lean": "late on rich-to-lean edges",
    "delay_lean_to_rich": "late on lean-to-rich edges",
    "delay_symmetric": "late on both edges",
    "transient": "slow and of reduced amplitude",
    "gain_low": "of reduced amplitude",
    "biased_lean": "reads too lean",
    "biased_rich": "reads too rich",
    "stuck_lean": "stuck at a lean value",
    "stuck_rich": "stuck at a rich value",
    "stuck_at_one": "stuck at 1",
    "not_ready": "does not become ready",
    "heater": "is not heated",
    "out_of_range": "outside the plausible range",
    "no_activity": "no longer follows the mixture",
    "intermittent": "holds now and then",
    "drift_lean": "drifts lean during the drive",
    "drift_rich": "drifts rich during the drive",
    "signal_missing": "signal is not received",
    "signal_invalid": "signal is sent as invalid",
    "bus_off": "the monitor itself is off the bus",
    "catalyst_low": "the catalyst stores too little oxygen",
    "downstream_slow_rich_to_lean": "the downstream sensor is slow on rich-to-lean edges",
    "downstream_slow_lean_to_rich": "the downstream sensor is slow on lean-to-rich edges",
    "downstream_slow_symmetric": "the downstream sensor is slow on both edges",
    "downstream_delay_rich_to_lean": "the downstream sensor is late on rich-to-lean edges",
    "downstream_delay_lean_to_rich": "the downstream sensor is late on lean-to-rich edges",
    "downstream_delay_symmetric": "the downstream sensor is late on both edges",
    "downstream_weak": "the downstream sensor is of reduced amplitude",
    "downstream_low": "the downstream sensor's voltage is too low",
    "downstream_high": "the downstream sensor's voltage is too high",
    "downstream_inactive": "the downstream sensor shows no activity",
    "downstream_heater": "the downstream sensor is not heated",
    "downstream_stuck_lean": "the downstream sensor is stuck at a lean value",
    "downstream_stuck_rich": "the downstream sensor is stuck at a rich value",
    "balance_lean": "the gas behind the catalyst is leaner than the upstream sensor says",
    "balance_rich": "the gas behind the catalyst is richer than the upstream sensor says",
    "memory_lost": "the monitor's fault memory was damaged and begins anew",
}

VERDICTS = {  # class: symbol, words
    "failed": ("✕", "fault found"),
    "passed": ("✓", "no fault"),
    "inconclusive": ("?", "not judged"),
}

STATISTICS = {
    "evidence": "evidence",
    "hypothesis": "best hypothesis",
    "dead_time_rich_to_lean_s": "dead time to lean, s",
    "dead_time_lean_to_rich_s": "dead time to rich, s",
    "lag_rich_to_lean_s": "lag to lean, s",
    "lag_lean_to_rich_s": "lag to rich, s",
    "gain": "gain",
    "gain_std": "gain std",
    "offset": "offset",
    "offset_std": "offset std",
    "offset_beyond": "offset beyond, std",
    "excitation": "excitation",
}


CATALYST_ALONE: Final = "the catalyst passed, nothing else was judged"


def is_catalyst_alone(recording: Mapping[str, Any]) -> bool:
    """Return whether of a drive with a verdict only the catalyst was judged."""
    method = (recording.get("catalyst") or {}).get("method")
    return method == "activity" and not recording["dtcs"] and not recording["not_judged"]


def verdict_of(recording: Mapping[str, Any]) -> str:
    """Return the verdict on a recording in the words of a window's verdict."""
    if recording["fault_flag"]:
        return "failed"
    return "inconclusive" if recording["not_judged"] else "passed"


def verdict_counts(recording: Mapping[str, Any]) -> dict[str, int]:
    """Return how many windows have each verdict, and how many fail by the paper's limits."""
    windows = recording["windows"]
    counts = {v: sum(w["verdict"] == v for w in windows) for v in VERDICTS}
    return counts | {"paper": sum(bool(w["paper_failed"]) for w in windows)}


def duration(seconds: float) -> str:
    """Return a duration in seconds or minutes."""
    return f"{seconds:.0f}\u00a0s" if seconds < 120 else f"{seconds / 60:.1f}\u00a0min"


def meaning(dtc: Mapping[str, Any]) -> str:
    """Return the meanings of a code's faults."""
    return ", or ".join(MEANINGS.get(f, f) for f in (dtc["fault"], *dtc.get("also", ())))


def confidence(recording: Mapping[str, Any]) -> str:
    """Return how sure the verdict is: by the evidence of the response test, or behind the catalyst.

    >>> far = {"log_odds": -30.0, "needed": 9.21}
    >>> confidence({"dtcs": [], "not_judged": None, "evidence": {"transient": far}})
    'nearest to a fault is transient: odds against it are 10¹³ to 1, 10⁴ to 1 are needed'
    """
    evidence: Mapping[str, Any] = recording.get("evidence") or {}
    said = []
    for dtc in recording["dtcs"]:
        each = evidence.get(dtc["fault"]) or catalyst.evidence(recording, dtc["fault"])
        if each and each["log_odds"] is not None:
            said.append(f"odds for {dtc['fault']} are {odds(each)}")
        if 0.0 < dtc.get("probability", 0.0) < 0.995:
            share = 100.0 * dtc["probability"]
            said.append(f"{share:.0f}\u00a0% for this name among those with {dtc['code']}")
    known = [(v["log_odds"], k) for k, v in evidence.items() if v["log_odds"] is not None]
    if known and not recording["dtcs"] and not recording["not_judged"]:
        log_odds, fault = max(known)
        side = "for" if log_odds > 0.0 else "against"
        said.append(f"nearest to a fault is {fault}: odds {side} it are {odds(evidence[fault])}")
    if said:
        return "; ".join(said)
    if recording["dtcs"]:
        return "not given: the test of this code has limits, no odds"
    return "none, a test is missing" if recording["not_judged"] else "every test ended"


def odds(evidence: Mapping[str, Any]) -> str:
    """Return how the evidence stands and what a decision needs, as odds to 1."""
    return f"{_to_one(evidence['log_odds'])}, {_to_one(evidence['needed'])} are needed"


def needed(evidence: Mapping[str, Any]) -> str:
    """Return what a decision needs, as odds to 1."""
    return f"odds of {_to_one(evidence['needed'])} are needed"


def _to_one(log_odds: float) -> str:
    if abs(log_odds) < math.log(_PLAIN):
        return f"{math.exp(abs(log_odds)):.0f} to 1"
    power = f"{abs(log_odds) / math.log(10.0):.0f}".translate(_SUPERSCRIPT)
    return f"10{power} to 1"


def seconds(dtc: Mapping[str, Any]) -> str:
    """Return the time of a code, empty if it has none."""
    return "" if dtc.get("t_s") is None else f"{dtc['t_s']:.1f} s"


def has_model(recording: Mapping[str, Any]) -> bool:
    """Return whether a model judged a recording: if so, it has that model's limits."""
    return "limits" in recording


def is_simulated(recording: Mapping[str, Any]) -> bool:
    """Return whether a recording says that it is simulated."""
    return bool(recording.get("source") == "simulated")
