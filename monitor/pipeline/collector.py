"""Events of a recording, collected into its entry of ``o2mon.replay/1`` and its series."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray, FloatArray
from monitor.judge.causes.causes import Asked, Judgement, SignalSource, causes
from monitor.judge.causes.observation import Observation
from monitor.judge.decision.window_facts import Evidence
from monitor.pipeline.entry import (
    dtc_entry,
    enable_shares,
    evidence_entry,
    limits_entry,
    not_judged,
    seconds,
    window_entry,
)
from monitor.pipeline.events import BlockEvent, CutJudged, RuleOff, Ticks, WindowJudged
from monitor.pipeline.monitor import SensorMonitor


@dataclass(frozen=True, slots=True)
class Trace:
    """The series of one recording on the sample grid."""

    t_s: FloatArray  # (n,) time since the first sample
    measured: FloatArray  # (n,) in the output's unit, NaN where invalid
    predicted: FloatArray  # (n,) in the output's unit, NaN while an input is invalid
    enabled: NDArray[np.bool_]  # (n,)
    fault_flag: NDArray[np.bool_]  # (n,)

    @classmethod
    def unpredicted(cls, t_s: FloatArray, measured: FloatArray) -> "Trace":
        """Return the series of a recording that no model judged."""
        off = np.zeros(len(t_s), dtype=np.bool_)
        return cls(t_s, measured, np.full(len(t_s), np.nan), off, off)


class Collector:
    """Gathers the events of one recording into the fields of ``o2mon.replay/1``."""

    def __init__(
        self,
        monitor: SensorMonitor,
        *,
        sources: Mapping[str, SignalSource] | None = None,
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
        judge, config = monitor.judge, monitor.judge.config.plausibility
        self._observation = Observation(monitor.enable, monitor.names, config, judge.period_s)
        self._asked = Asked(judge.card, judge.config, sources or {}, monitor.limits)
        self._windows: deque[dict[str, Any]] = deque(maxlen=keep)
        self._n_windows = self._n_excited = self._n_cuts = 0
        self._series = _Series(keep_samples) if trace else None
        self._output = monitor.names.index(monitor.output)
        self._flag = monitor.store.fault_flag
        self.notes: list[str] = []  # what was not judged as asked

    def push(self, event: BlockEvent) -> None:
        """Take one event."""
        if isinstance(event, Ticks):
            self._tick(event)
        elif isinstance(event, WindowJudged):
            self._windows.append(window_entry(event, self.begin_ns))
            self._n_windows += 1
            self._n_excited += event.excited
        elif isinstance(event, CutJudged):
            self._n_cuts += 1
        elif isinstance(event, RuleOff):
            self.notes.append(event.said)
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
        self._observation.push(block.values, block.quality, ticks.conditions)
        if self._series is not None:
            t_s = (ticks.block.t_ns - self._t0_ns) / 1e9
            measured = ticks.block.values[:, self._output]
            self._series.push((t_s, measured, ticks.predicted, ticks.enabled, self._flag))

    def result(self, path: str, sha256: str | None, counters: Mapping[str, int]) -> dict[str, Any]:
        """Return the recording's entry of the JSON."""
        monitor, facts = self._monitor, self._monitor.decisions.facts
        outcomes, evidence = monitor.outcomes, facts.evidence()
        seen = self._observation.observed()
        judgement = Judgement(
            self._n_windows,
            self._n_excited,
            tuple(test for test, own in outcomes.items() if own == "undecided"),
            _left_s(evidence),
            judges_cuts=self._n_cuts > 0,
            is_foreign=monitor.decisions.is_foreign,
        )
        why = [] if monitor.store.fault_flag else causes(seen, self._asked, judgement)
        behind = monitor.catalyst.entry()
        trust = monitor.limits.trust.entry(facts.response.explained)
        return {
            "path": path,
            "sha256": sha256,
            "samples": monitor.samples,
            "enabled_samples": monitor.enabled_samples,
            "windows": list(self._windows),
            "windows_interrupted": monitor.windows.discarded,
            "windows_dropped": self._n_windows - len(self._windows),
            "dtcs": [
                dtc_entry(dtc, self.begin_ns, facts.probability(dtc.fault))
                for dtc in monitor.store.active
            ],
            "fault_flag": monitor.store.fault_flag,
            "completed": monitor.decisions.completed,
            "not_judged": not_judged(why),
            "tests": outcomes,
            **({"windows_fuel_cut": self._n_cuts} if self._n_cuts else {}),
            "evidence": evidence_entry(evidence),
            "enable": enable_shares(
                seen.held.tolist(), monitor.samples, monitor.enable.unavailable
            ),
            "limits": limits_entry(monitor.limits),
            **({"trust": trust} if trust else {}),
            "counters": dict(counters),
            **({} if behind is None else {"catalyst": behind}),
        }

    def trace(self) -> Trace:
        """Return the series on the sample grid, for the report."""
        columns = (self._series or _Series(None)).columns()
        on = (column.astype(np.bool_) for column in columns[3:])
        return Trace(*columns[:3], *on)


def _left_s(evidence: Mapping[str, Evidence]) -> float | None:
    """Return the driving in s that the slowest decision of the response test still needs."""
    left = [each.seconds_to_decision for each in evidence.values()]
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
