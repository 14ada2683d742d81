"""Events of a monitor become records; samples are thinned to a few records a second."""

import math
from collections.abc import Iterator
from typing import Final

from monitor.base.types import Quality
from monitor.judge.enable import CONDITIONS
from monitor.memory.dtc import Dtc
from monitor.pipeline.events import CutJudged, CycleStarted, DtcChanged, Event, Tick, WindowJudged
from monitor.pipeline.monitor import SensorMonitor
from monitor.sinks.record import Record, Value

_GOOD: Final = int(Quality.GOOD)
HEALED: Final = "healed"  # state of a code that is neither pending nor confirmed


class Stream:
    """Turns the events of one monitor into records.

    rate_hz : most "signals" records per second; measurement, prediction and residual are means
        over the samples between two of them, other signals are the latest
    """

    def __init__(self, monitor: SensorMonitor, rate_hz: float) -> None:
        self._monitor = monitor
        self._output = monitor.names.index(monitor.output)
        self._names = tuple(monitor.names)
        self._means = monitor.output, "predicted", "residual"
        period_s = monitor.judge.period_s
        self._step = max(1, math.ceil(round(1.0 / (rate_hz * period_s), 6)))
        self._seen: list[tuple[float, ...]] = []  # values of the means since the last record
        self._windows = 0
        self._verdicts: dict[str, tuple[str, str | None]] = {}  # of windows, of fuel cuts
        self._states: dict[str, str | None] = {d.code: d.state for d in monitor.store.active}

    def push(self, event: Event) -> Iterator[Record]:
        """Yield the records of an event."""
        if isinstance(event, Tick):
            yield from self._tick(event)
        elif isinstance(event, WindowJudged | CutJudged):
            yield from self._judged(event)
        elif isinstance(event, DtcChanged):
            yield from self._code(event.t_ns, event.dtc)
        elif isinstance(event, CycleStarted):
            yield Record("cycle", event.t_ns, {"started": True})

    def _judged(self, event: WindowJudged | CutJudged) -> Iterator[Record]:
        """Yield a record if the verdict or the fault is another one than before."""
        of, mean = "fuel_cut", math.nan
        if isinstance(event, WindowJudged):
            of, mean = "window", event.mean
            self._windows += 1
        verdict = event.outcome, event.fault
        if verdict == self._verdicts.get(of):
            return
        self._verdicts[of] = verdict
        values: dict[str, Value] = {"of": of, "verdict": event.outcome, "fault": event.fault or ""}
        if math.isfinite(mean):
            values["mean"] = mean
        yield Record("verdict", event.window.t_end_ns, values)

    def _code(self, t_ns: int, dtc: Dtc) -> Iterator[Record]:
        """Yield a record if the code's state is another one than before."""
        if dtc.state == self._states.get(dtc.code):
            return
        self._states[dtc.code] = dtc.state
        told = {"code": dtc.code, "fault": dtc.fault, "also": " ".join(dtc.also)}
        state = {"state": dtc.state or HEALED, "status": int(dtc.status)}
        yield Record("code", t_ns, {**told, **state})

    def _tick(self, tick: Tick) -> Iterator[Record]:
        sample = tick.sample
        measured = sample.values.item(self._output)
        self._seen.append((measured, tick.predicted, measured - tick.predicted))
        if (sample.index + 1) % self._step == 0:
            yield Record("signals", sample.t_ns, self._signals(tick))

    def _signals(self, tick: Tick) -> dict[str, Value]:
        values: dict[str, Value] = {}
        for name, column in zip(self._means, zip(*self._seen, strict=True), strict=True):
            finite = [value for value in column if math.isfinite(value)]
            if finite:
                values[name] = sum(finite) / len(finite)
        self._seen.clear()
        sample = tick.sample
        for i, name in enumerate(self._names):
            if i != self._output and sample.quality.item(i) == _GOOD:
                values[name] = sample.values.item(i)
        waits = "" if tick.enabled else CONDITIONS[tick.conditions.index(False)]
        store = self._monitor.store
        values |= {"enabled": tick.enabled, "waits_for": waits, "windows": self._windows}
        return values | {"mil": store.mil, "dtcs": len(store.active)}
