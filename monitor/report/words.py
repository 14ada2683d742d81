"""The words of the report: meanings of faults, verdicts, numbers with their units; no HTML."""

import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

from monitor.memory.codes import CONTINUOUS, OF_MONITOR
from monitor.report import catalyst

VERDICTS = {  # class: symbol, words
    "failed": ("✕", "fault found"),
    "passed": ("✓", "no fault"),
    "inconclusive": ("?", "not judged"),
}

COUNTED = {  # of ``counters``: what is left out, late or missing
    "length": "frames of another length",
    "checksum": "frames with a wrong checksum",
    "stuck": "frames whose counter stood still",
    "lost": "frames that the counter misses",
    "not_available": "values that the sender calls not available",
    "out_of_range": "values out of range",
    "late": "frames out of their order",
    "discontinuities": "jumps of the time",
    "skipped": "error and remote frames",
    "clock_steps": "steps of the clock",
    "log_gaps": "pauses of the whole log",
    "damaged_lines": "damaged lines",
    "outliers": "frames with a time that others contradict",
}

CATALYST_ALONE: Final = "the catalyst passed, nothing else was judged"


def is_catalyst_alone(recording: Mapping[str, Any]) -> bool:
    """Return whether of a drive without a fault only the catalyst was judged."""
    is_sound = not recording.get("fault_flag") and not recording["not_judged"]
    return is_sound and (recording.get("catalyst") or {}).get("method") == "activity"


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


def not_listed(recording: Mapping[str, Any]) -> str:
    """Return which windows ``verdict_counts`` counts, "" where it counts all."""
    n, dropped = len(recording["windows"]), recording.get("windows_dropped", 0)
    return f" (the latest {n} of {n + dropped})" if dropped else ""


class Advice(NamedTuple):
    """What a fault does to the car, its likely causes, likeliest first, and what to check next."""

    effect: str
    causes: list[str]
    check: str


@cache
def known_faults() -> dict[str, tuple[str, Advice]]:
    """Return meaning and advice of each fault, from ``faults.toml`` beside this file."""
    tree = tomllib.loads(files("monitor.report").joinpath("faults.toml").read_text("utf-8"))
    advice = {name: Advice(**each) for name, each in tree["advice"].items()}
    return {
        name: (each["meaning"], advice[each["advice"]]) for name, each in tree["faults"].items()
    }


def meaning(fault: str, also: Iterable[str] = ()) -> str:
    """Return the meanings of a code's faults; a fault of a plug-in has its name only."""
    known, faults = known_faults(), [fault, *also]
    return ", or ".join(known[each][0] if each in known else each for each in faults if each)


def advice(dtcs: Iterable[Mapping[str, Any]]) -> list[tuple[str, Advice]]:
    """Return codes with what to do about them; codes with the same advice stand together."""
    codes: dict[str, list[str]] = {}
    told: dict[str, Advice] = {}
    for dtc in dtcs:
        if dtc["fault"] in known_faults():
            each = known_faults()[dtc["fault"]][1]
            told[each.check] = each
            codes.setdefault(each.check, []).append(dtc["code"])
    return [(", ".join(dict.fromkeys(codes[check])), each) for check, each in told.items()]


def confidence(recording: Mapping[str, Any]) -> str:
    """Return how sure the verdict is: by the evidence of the response test, or behind the catalyst.

    >>> far = {"log_odds": -30.0, "needed": 9.21}
    >>> confidence({"dtcs": [], "not_judged": None, "evidence": {"transient": far}})
    'nearest to a fault is transient: against it stands 3.3 times the evidence a decision needs'
    """
    evidence: Mapping[str, Any] = recording.get("evidence") or {}
    said, dtcs = [], [d for d in recording["dtcs"] if d["fault"] not in OF_MONITOR]
    for dtc in dtcs:
        each = evidence.get(dtc["fault"]) or catalyst.evidence(recording, dtc["fault"])
        if each and each["log_odds"] is not None:
            side = "against" if each["log_odds"] < 0.0 else "for"  # a code may outlive its fault
            said.append(f"{side} {dtc['fault']} stands {amount(each)}")
        if 0.0 < dtc.get("probability", 0.0) < 0.995:
            share = 100.0 * dtc["probability"]
            said.append(f"{share:.0f}\u00a0% for {dtc['fault']} among the names of {dtc['code']}")
    known = [(v["log_odds"], k) for k, v in evidence.items() if v["log_odds"] is not None]
    if known and not dtcs and not recording["not_judged"]:
        log_odds, fault = max(known)
        side = "for" if log_odds > 0.0 else "against"
        said.append(f"nearest to a fault is {fault}: {side} it stands {amount(evidence[fault])}")
    if said:
        return "; ".join(dict.fromkeys(said))  # two codes may stand for one fault
    if dtcs:
        return "not given: the test of this code compares with limits and weighs no evidence"
    if recording["not_judged"]:
        return "none, a test is missing"
    return CATALYST_ALONE if is_catalyst_alone(recording) else "every test ended"


def amount(evidence: Mapping[str, Any]) -> str:
    """Return how much evidence there is, against that which a decision needs.

    Not as odds: they rest on the model's own account of its errors, and say more than is known.
    """
    share = abs(evidence["log_odds"]) / evidence["needed"]
    words = f"{share:.1f} times" if share >= 1.0 else f"{100.0 * share:.0f}\u00a0% of"
    return f"{words} the evidence a decision needs"


def passed_beside(recording: Mapping[str, Any]) -> str:
    """Return which tests passed beside one that is not decided, but for those of the wiring.

    >>> passed_beside({"tests": {"range": "passed", "bias": "passed", "response": "undecided"}})
    'no fault in bias; '
    """
    tested = {k: v for k, v in recording.get("tests", {}).items() if k not in CONTINUOUS}
    passed = [test for test, own in tested.items() if own == "passed"]
    is_part = passed and "undecided" in tested.values()
    return f"no fault in {', '.join(passed)}; " if is_part else ""


def tests(recording: Mapping[str, Any]) -> str:
    """Return which tests failed, passed and are undecided, "" where none of them ran.

    >>> tests({"tests": {"response": "passed", "bias": "passed", "activity": "undecided"}})
    'passed: response, bias; undecided: activity'
    """
    found: Mapping[str, str] = recording.get("tests", {})
    groups = {
        outcome: [test for test, own in found.items() if own == outcome]
        for outcome in ("failed", "passed", "undecided")
    }
    return "; ".join(f"{outcome}: {', '.join(own)}" for outcome, own in groups.items() if own)


def counted_out(recording: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Return in words what was left out, late or missing in a recording, and how often.

    >>> counted_out({"counters": {"lost": 3, "late": 0, "unmapped": 9}})
    [('frames that the counter misses', 3)]
    >>> counted_out({"counters": {"out_of_range_lambda_measured": 5}})
    [('values out of range of lambda_measured', 5)]
    """
    counters: Mapping[str, int] = recording.get("counters", {})
    return [(_counted(k), n) for k, n in counters.items() if n and k != "unmapped"]


def _counted(key: str) -> str:
    """Return a counter in words; a table has one of values out of range for each signal."""
    signal = key.removeprefix("out_of_range_")
    return COUNTED.get(key, key if signal == key else f"{COUNTED['out_of_range']} of {signal}")


def has_model(recording: Mapping[str, Any]) -> bool:
    """Return whether a model judged a recording: if so, it has that model's limits."""
    return "limits" in recording


def is_simulated(recording: Mapping[str, Any]) -> bool:
    """Return whether a recording says that it is simulated."""
    return bool(recording.get("source") == "simulated")
