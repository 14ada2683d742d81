"""Verdicts and events as lines of text."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

from monitor.base.files.junit import JunitCase
from monitor.judge import trust
from monitor.judge.causes.causes import Cause
from monitor.memory.dtc import Status
from monitor.pipeline.collector import Collector
from monitor.pipeline.entry import fault_words
from monitor.pipeline.events import Counted, CutJudged, CycleStarted, DtcChanged, Happening, RuleOff
from monitor.report import evidence
from monitor.report.words import (
    CATALYST_ALONE,
    advice,
    counted_out,
    is_catalyst_alone,
    is_simulated,
    not_listed,
    passed_beside,
    tests,
    verdict_counts,
)

COUNTS: Final = {
    "ignition_cycle": "an ignition cycle is counted",
    "warm_up": "a warm-up is counted",
    "general_denominator": "a drive that counts for the in-use ratios",
    "numerator": "the test of {test} is completed and counts for its in-use ratio",
}


def verdict_text(recording: Mapping[str, Any]) -> str:
    """Return the verdict on one recording in words."""
    return "; ".join(verdict_lines(recording))


def verdict_lines(recording: Mapping[str, Any]) -> list[str]:
    """Return the verdict on one recording in words, each further cause on its own line."""
    if recording["fault_flag"]:
        codes = ", ".join(
            f"{d['code']} {fault_words(d)} ({d['state']}{_when(d)})" for d in recording["dtcs"]
        )
        return [f"FAULT: {codes}"]
    if not recording["not_judged"]:
        if is_catalyst_alone(recording):
            return [CATALYST_ALONE]
        left = recording.get("trust", {}).get("not_tested")
        return [f"no fault, not tested: {', '.join(left)}" if left else "no fault"]
    first, *others = (Cause(**cause).in_words for cause in recording["not_judged"])
    if not recording["samples"]:
        first, others = "nothing was received", []
    return [f"{passed_beside(recording)}not judged: {first}", *others]


def _when(dtc: Mapping[str, Any]) -> str:
    return "" if dtc["t_s"] is None else f", {dtc['t_s']:.0f} s"


def event_line(event: Happening, collector: Collector) -> str:
    """Return one line about an event that is no tick."""
    if isinstance(event, CycleStarted):
        return f"{collector.seconds(event.t_ns):8.1f} s  a driving cycle begins"
    if isinstance(event, Counted):
        what = COUNTS[event.what].format(test=event.test)
        return f"{collector.seconds(event.t_ns):8.1f} s  {what}"
    if isinstance(event, DtcChanged):
        dtc = event.dtc
        state: str = dtc.state or "is not set"
        state += ", does not fail now" * bool(dtc.state and not dtc.status & Status.TEST_FAILED)
        return f"{collector.seconds(event.t_ns):8.1f} s  {dtc.code} {dtc.fault} {state}"
    if isinstance(event, RuleOff):
        return f"{collector.seconds(event.t_ns):8.1f} s  {event.said}"
    if isinstance(event, CutJudged):
        t_s = collector.seconds(event.window.t_end_ns)
        return f"{t_s:8.1f} s  window around a fuel cut  {event.outcome} {event.fault or ''}"
    paper = "  paper: failed" if event.paper_failed else ""
    return (
        f"{collector.seconds(event.window.t_end_ns):8.1f} s  window {event.window.index}  "
        f"mean {event.mean:+.4f}  std {event.std:.4f}  {event.outcome} {event.fault or ''}{paper}"
    )


def print_recording(recording: Mapping[str, Any], *, windows: bool = False) -> Iterable[str]:
    """Yield the lines that a command prints about one recording."""
    counts = verdict_counts(recording)
    if windows:
        for w in recording["windows"]:
            yield (
                f"  {w['t_start_s']:8.1f} s  mean {w['mean']:+.4f}  std {w['std']:.4f}  "
                f"{w['verdict']:<12} {w['fault'] or ''}{'  paper: failed' * w['paper_failed']}"
            )
    judged = ", ".join(f"{counts[name]} {name}" for name in ("passed", "failed", "inconclusive"))
    judged += not_listed(recording)
    simulated = " (simulated)" if is_simulated(recording) else ""
    verdict, *others = verdict_lines(recording)
    yield f"{recording['path']}{simulated}: {verdict}"
    yield from (f"  and {other}" for other in others)
    yield from advice_lines(recording["dtcs"])
    yield (
        f"  {recording['enabled_samples']} of {recording['samples']} samples enabled; windows: "
        f"{judged}; paper's rule failed {counts['paper']}"
    )
    if known := trust.in_words(recording.get("trust")):
        yield f"  {known}"
    if recording["not_judged"]:
        if told := tests(recording):
            yield f"  {told}"
        yield from (f"  {line}" for line in evidence.undecided(recording))
    if not recording["fault_flag"]:
        for d in recording["dtcs"]:  # of the monitor itself
            yield f"  {d['code']} {d['fault']} ({d['state']})"
    if recording.get("profile"):
        yield f"  read with the profile {recording['profile']}"
    for note in recording.get("notes", ()):
        yield f"  note: {note}"
    if bad := counted_out(recording):
        yield "  left out, late or missing: " + ", ".join(f"{n} {words}" for words, n in bad)


def advice_lines(dtcs: Iterable[Mapping[str, Any]]) -> Iterable[str]:
    """Yield what codes mean for the car, their likely causes and what to check next."""
    for codes, each in advice(dtcs):
        yield f"  {codes}: {each.effect}"
        yield f"    likely: {'; '.join(each.causes)}"
        yield f"    next: {each.check}"


def case(recording: Mapping[str, Any]) -> JunitCase:
    """Return a recording as a test of a CI server: a fault fails, without verdict it is skipped."""
    codes = ", ".join(dtc["code"] for dtc in recording["dtcs"]) if recording["fault_flag"] else ""
    said = verdict_text(recording) if codes or recording["not_judged"] else ""
    return JunitCase(recording["path"], "\n".join(print_recording(recording)), said, codes)
