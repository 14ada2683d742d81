"""Where events go: collected into the result of a recording, printed, written as JSON."""

import json
import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.outputs import write_text
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.causes import Asked, Cause, Judgement, Source, causes
from monitor.pipeline.entry import (
    dtc_entry,
    enable_shares,
    evidence_entry,
    fault_words,
    fuel_cuts_entry,
    limits_entry,
    not_judged,
    seconds,
    window_entry,
)
from monitor.pipeline.events import (
    BlockEvent,
    Counted,
    CutJudged,
    CycleStarted,
    DtcChanged,
    Happening,
    Ticks,
    WindowJudged,
)
from monitor.pipeline.monitor import Monitor
from monitor.report import evidence, fuel_cuts
from monitor.report.text import Trace

SCHEMA = "o2mon.replay/1"


class Collector:
    """Gathers the events of one recording into the fields of ``o2mon.replay/1``."""

    def __init__(
        self,
        monitor: Monitor,
        *,
        sources: Mapping[str, Source] | None = None,
        trace: bool = False,
        keep: int | None = None,
        keep_samples: int | None = None,
    ) -> None:
        """Begin a recording.

        sources : where each signal comes from
        trace : keep the series for a report
        keep, keep_samples : how many windows and samples to keep, the latest; None keeps all
        """
        self._monitor = monitor
        self._t0_ns: int | None = None
        self._observation = monitor.observation()
        judge = monitor.judge
        self._asked = Asked(judge.card, judge.config, sources or {}, monitor.limits)
        self._windows: deque[dict[str, Any]] = deque(maxlen=keep)
        self._n_windows = self._n_excited = self._n_outside = self._n_cuts = 0
        self._series = _Series(keep_samples) if trace else None
        self._output = monitor.names.index(monitor.output)
        self._flag = monitor.store.fault_flag

    def push(self, event: BlockEvent) -> None:
        """Take one event."""
        if isinstance(event, Ticks):
            self._tick(event)
        elif isinstance(event, WindowJudged):
            self._windows.append(window_entry(event, self.begin_ns))
            self._n_windows += 1
            self._n_excited += event.excited
            self._n_outside += event.is_outside
        elif isinstance(event, CutJudged):
            self._n_cuts += 1
        else:
            self._flag = self._monitor.store.fault_flag

    @property
    def begin_ns(self) -> int:
        """Return the time of the recording's first sample, 0 before it."""
        return self._t0_ns or 0

    def seconds(self, t_ns: int) -> float:
        """Return a time in seconds since the recording's first sample."""
        return seconds(t_ns, self.begin_ns)

    def _tick(self, ticks: Ticks) -> None:
        if self._t0_ns is None:
            self._t0_ns = ticks.block.t_ns.item(0)
        block = ticks.block
        self._observation.push(block.values, block.quality, ticks.conditions, ticks.predicted)
        if self._series is not None:
            t_s = (ticks.block.t_ns - self._t0_ns) / 1e9
            measured = ticks.block.values[:, self._output]
            self._series.push((t_s, measured, ticks.predicted, ticks.enabled, self._flag))

    def result(self, path: str, sha256: str | None, counters: Mapping[str, int]) -> dict[str, Any]:
        """Return the recording's entry of the JSON."""
        monitor = self._monitor
        seen = self._observation.observed()
        judgement = Judgement(
            self._n_windows,
            self._n_excited,
            monitor.unfinished,
            _left_s(monitor),
            self._n_outside,
            judges_cuts=monitor.limits.evidence_cut > 0.0,
            cut_faults=monitor.decisions.fuel_cuts.faults,
        )
        is_faulty = monitor.store.fault_flag
        why = [] if is_faulty else causes(seen, self._asked, judgement)
        behind = monitor.catalyst.entry()
        cuts = monitor.decisions.fuel_cuts
        return {
            "path": path,
            "sha256": sha256,
            "samples": monitor.samples,
            "enabled_samples": monitor.enabled_samples,
            "windows": list(self._windows),
            "windows_interrupted": monitor.interrupted_windows,
            "windows_dropped": self._n_windows - len(self._windows),
            "dtcs": [
                dtc_entry(dtc, self.begin_ns, monitor.decisions.probability(dtc.fault))
                for dtc in monitor.store.active
            ],
            "fault_flag": monitor.store.fault_flag,
            "completed": monitor.completed,
            "not_judged": not_judged(why),
            **({"windows_fuel_cut": self._n_cuts} if monitor.limits.evidence_cut else {}),
            **({"fuel_cut_response": fuel_cuts_entry(cuts)} if cuts.cuts else {}),
            "evidence": evidence_entry(monitor.decisions.evidence()),
            "enable": enable_shares(seen.held.tolist(), monitor.samples, monitor.unavailable),
            "limits": limits_entry(monitor.limits),
            "counters": dict(counters),
            **({} if behind is None else {"catalyst": behind}),
        }

    def trace(self) -> Trace:
        """Return the series on the sample grid, for the report."""
        columns = (self._series or _Series(None)).columns()
        on = (column.astype(np.bool_) for column in columns[3:])
        return Trace(*columns[:3], *on)


def _left_s(monitor: Monitor) -> float | None:
    """Return the driving in s that the slowest decision of the response test still needs."""
    left = [each.seconds_to_decision for each in monitor.decisions.evidence().values()]
    known = [each for each in left if each is not None]
    return max(known) if known and len(known) == len(left) else None


class _Series:
    """Columns of a trace that grow block by block.

    keep : how many samples to keep, the latest; None keeps all
    """

    def __init__(self, keep: int | None) -> None:
        self._keep = keep
        self._columns = np.empty((5, 1024))
        self._n = 0

    def push(self, columns: Sequence[FloatArray | BoolArray | bool]) -> None:
        """Add samples, column by column."""
        n = len(np.atleast_1d(columns[0]))
        if self._n + n > self._columns.shape[1]:
            kept = self.columns()
            self._n = kept.shape[1]
            self._columns = np.empty((5, 2 * max(self._n + n, 1024)))
            self._columns[:, : self._n] = kept
        for row, column in zip(self._columns, columns, strict=True):
            row[self._n : self._n + n] = column
        self._n += n

    def columns(self) -> FloatArray:
        """Return the samples kept, (5, n)."""
        first = 0 if self._keep is None else max(self._n - self._keep, 0)
        return self._columns[:, first : self._n]


def verdict_text(recording: Mapping[str, Any]) -> str:
    """Return the verdict on one recording in words."""
    if recording["fault_flag"]:
        codes = ", ".join(
            f"{d['code']} {fault_words(d)} ({d['state']}{_when(d)})" for d in recording["dtcs"]
        )
        return f"FAULT: {codes}"
    if not recording["not_judged"]:
        return "no fault"
    return f"not judged: {reason(recording)}"


def verdict_lines(recording: Mapping[str, Any]) -> list[str]:
    """Return the verdict on one recording in words, each further cause on its own line."""
    causes = recording["not_judged"]
    if recording["fault_flag"] or not causes or not recording["samples"]:
        return [verdict_text(recording)]
    first, *others = (Cause(**cause).in_words for cause in causes)
    return [f"not judged: {first}", *others]


def _when(dtc: Mapping[str, Any]) -> str:
    return "" if dtc["t_s"] is None else f", {dtc['t_s']:.0f} s"


def reason(recording: Mapping[str, Any]) -> str:
    """Return in words why a recording was not judged."""
    if not recording["samples"]:
        return "nothing was received"
    return "; ".join(Cause(**cause).in_words for cause in recording["not_judged"])


def event_line(event: Happening, collector: Collector) -> str:
    """Return one line about an event that is no tick."""
    if isinstance(event, CycleStarted):
        return f"{collector.seconds(event.t_ns):8.1f} s  a driving cycle begins"
    if isinstance(event, Counted):
        return f"{collector.seconds(event.t_ns):8.1f} s  counted: {event.what.replace('_', ' ')}"
    if isinstance(event, DtcChanged):
        dtc = event.dtc
        state = dtc.state or "is no longer set"
        return f"{collector.seconds(event.t_ns):8.1f} s  {dtc.code} {dtc.fault} {state}"
    if isinstance(event, CutJudged):
        said = f"{event.outcome} {event.fault or ''}"
        return f"{collector.seconds(event.t_ns):8.1f} s  window around a fuel cut  {said}"
    paper = "  paper: failed" if event.paper_failed else ""
    return (
        f"{collector.seconds(event.window.t_end_ns):8.1f} s  window {event.window.index}  "
        f"mean {event.mean:+.4f}  std {event.std:.4f}  {event.outcome} {event.fault or ''}{paper}"
    )


def print_recording(recording: Mapping[str, Any], *, windows: bool = False) -> Iterable[str]:
    """Yield the lines that a command prints about one recording."""
    counts = {"passed": 0, "failed": 0, "inconclusive": 0}
    for window in recording["windows"]:
        counts[window["verdict"]] += 1
    if windows:
        for w in recording["windows"]:
            yield (
                f"  {w['t_start_s']:8.1f} s  mean {w['mean']:+.4f}  std {w['std']:.4f}  "
                f"{w['verdict']:<12} {w['fault'] or ''}{'  paper: failed' * w['paper_failed']}"
            )
    judged = ", ".join(f"{n} {name}" for name, n in counts.items())
    paper = sum(w["paper_failed"] for w in recording["windows"])
    simulated = " (simulated)" if recording.get("source") == "simulated" else ""
    verdict, *others = verdict_lines(recording)
    yield f"{recording['path']}{simulated}: {verdict}"
    yield from (f"  and {other}" for other in others)
    yield (
        f"  {recording['enabled_samples']} of {recording['samples']} samples enabled; windows: "
        f"{judged}; paper's rule failed {paper}"
    )
    yield from (f"  {line}" for line in fuel_cuts.lines(recording, in_detail=windows))
    if recording["not_judged"]:
        yield from (f"  {line}" for line in evidence.undecided(recording))
    if not recording["fault_flag"]:
        for d in recording["dtcs"]:  # of the monitor itself
            yield f"  {d['code']} {d['fault']} ({d['state']})"
    bad = {name: n for name, n in recording["counters"].items() if n and name != "unmapped"}
    if recording.get("profile"):
        yield f"  read with the profile {recording['profile']}"
    for note in recording.get("notes", ()):
        yield f"  note: {note}"
    if bad:
        yield "  counted: " + ", ".join(f"{name} {n}" for name, n in bad.items())


def write_json(path: Path, result: Mapping[str, Any]) -> None:
    """Write a result as JSON; the same result gives the same bytes."""
    write_text(path, json.dumps(rounded(result), indent=1, allow_nan=False) + "\n")


def rounded(value: Any) -> Any:
    """Round floats to nine decimals; numbers that are not finite become null."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float):
        return round(value, 9) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {k: rounded(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(v) for v in value]
    return value
