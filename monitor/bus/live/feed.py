"""The live page's feed in the loop: it gathers events and writes them to the server's pipe.

It never waits. It writes four messages a second, each one line of JSON. If the pipe is full, up to
a minute of samples wait for the next message; older ones are dropped and counted.
"""

import json
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Final

import numpy as np

from monitor import __version__
from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.bus.live.codes import fault_memory
from monitor.bus.live.describe import ConditionWords, response_limits, signal_rows, words
from monitor.bus.live.process import Server
from monitor.judge.findings import WindowJudged
from monitor.pipeline.entry import evidence_entry, window_fields
from monitor.pipeline.events import CycleStarted, Event, Tick
from monitor.pipeline.monitor import SensorMonitor
from monitor.pipeline.replay import Setup
from monitor.report import catalyst, evidence
from monitor.report.vehicle_offset import VehicleOffset
from monitor.report.words import confidence

MESSAGE_S: Final = 0.25
SLOW_S: Final = 1.0  # interval of health and fault memory
SAMPLE_NS: Final = 100_000_000  # at most ten samples a second are shown
SAMPLES: Final = 600  # most samples kept for the next messages
WINDOWS: Final = 100


class LiveFeed(Attachment):
    """Feeds the live page.

    health : returns the loop's counters
    channel : name of the bus on the page
    say : receives the message that a server has died
    """

    due_s = -math.inf

    def __init__(
        self,
        server: Server,
        monitor: SensorMonitor,
        setup: Setup,
        *,
        health: Callable[[], Mapping[str, Any]],
        channel: str,
        say: Callable[[str], None],
    ) -> None:
        self._server, self._monitor, self._health, self._say = server, monitor, health, say
        card = setup.model.card
        self._conditions = ConditionWords(monitor, setup.config.enable, card)
        self._step = max(1, math.ceil(SAMPLE_NS / card.period_ns))
        self._output = monitor.names.index(monitor.output)
        self._samples: deque[list[Any]] = deque(maxlen=SAMPLES)
        self._windows: deque[dict[str, Any]] = deque(maxlen=WINDOWS)
        self._latest: Tick | None = None
        self._t0_ns: int | None = None
        self._counts = Counter[str]()  # windows by verdict
        self._slow_s = -math.inf
        self._absent: Collection[str] = ()
        self.dropped = 0
        self._news: dict[str, Any] = {  # for the next message, beside the events
            "run": str(time.time_ns()),  # a page of an earlier run loads itself anew
            "version": __version__,
            "channel": channel,
            "model": setup.model.path.name,
            "output": card.output.name,
            "window_samples": setup.config.window.n_samples,
            "conditions": self._conditions.wanted(),
        }
        self._begin_cycle()

    def push(self, event: Event) -> None:
        """Keep an event for the next message."""
        if isinstance(event, Tick):
            self._tick(event)
        elif isinstance(event, WindowJudged):
            self._counts[event.outcome] += 1
            self._keep(self._windows, self._window(event))
        else:
            if isinstance(event, CycleStarted):
                self._begin_cycle()
            self._slow_s = -math.inf

    def work(self, now_s: float) -> Iterable[Frame]:
        """Write the gathered events, four times a second."""
        if now_s >= self.due_s:
            self.due_s = now_s + MESSAGE_S
            try:
                if self._server.is_free:
                    self._server.send(self._message(now_s))
            except BrokenPipeError:
                self.due_s = math.inf
                self._say("the live page's server has died; judging goes on without the page")
        return ()

    def close(self) -> None:
        """Send the last events and end the server."""
        self._slow_s = self.due_s = -math.inf
        self._say = lambda _: None  # the service manager may have ended the server before
        self.work(0.0)
        self._server.close()

    def _tick(self, tick: Tick) -> None:
        self._latest, sample = tick, tick.sample
        if self._t0_ns is None:
            self._t0_ns = sample.t_ns
        measured = sample.values.item(self._output)
        if tick.enabled and not self._monitor.store.fault_flag:
            self._offset.push(np.array([measured - tick.predicted]))
        if sample.index % self._step:
            return
        held = sum(1 << i for i, condition in enumerate(tick.conditions) if condition)
        values = _number(measured), _number(tick.predicted)
        self._keep(self._samples, [self._ms(sample.t_ns), *values, held])

    def _keep(self, kept: deque[Any], item: Any) -> None:
        self.dropped += len(kept) == kept.maxlen
        kept.append(item)

    def _ms(self, t_ns: int) -> float:
        return (t_ns - (self._t0_ns or 0)) // 10_000 / 100

    def _window(self, event: WindowJudged) -> dict[str, Any]:
        window, fields = event.window, window_fields(event)
        times = {"start_ms": self._ms(window.t_start_ns), "end_ms": self._ms(window.t_end_ns)}
        return times | _numbers(fields) | {"statistics": _numbers(fields["statistics"])}

    def _message(self, now_s: float) -> bytes:
        message, self._news = self._news, {}
        message |= {"samples": list(self._samples), "windows": list(self._windows)}
        self._samples.clear()
        self._windows.clear()
        if now_s >= self._slow_s:
            self._slow_s = now_s + SLOW_S
            health = dict(self._health()) | {"page_dropped": self.dropped}
            self._absent = health.get("absent", ())
            named = {key: [*map(words, health.get(key, ()))] for key in ("absent", "stale")}
            message["health"] = health | named
            told = self._evidence() | {"fault_flag": self._monitor.store.fault_flag}
            message["memory"] = fault_memory(self._monitor.store) | {
                "behind": catalyst.rows(self._monitor.catalyst.entry()),
                "confidence": self._confidence(),
                "evidence": [[fault, left] for fault, _, left in evidence.rows(told)],
            }
            offset = self._offset.value(dtc.fault for dtc in self._monitor.store.active)
            message["vehicle_offset"] = None if offset is None else _number(offset)
        if self._latest:
            message["now"] = self._now(self._latest)
        return json.dumps(message, separators=(",", ":"), allow_nan=False).encode() + b"\n"

    def _begin_cycle(self) -> None:
        """Begin a driving cycle, with the limits that the vehicle's reference has learned."""
        judge, limits = self._monitor.judge, self._monitor.limits
        self._offset = VehicleOffset(limits.offset_low, limits.offset_high, judge.period_s)
        self._news["limits"] = response_limits(judge.config, limits)

    def _confidence(self) -> str:
        """Return how sure the verdict so far is, in the words of the report."""
        monitor = self._monitor
        codes = [{"fault": dtc.fault} for dtc in monitor.store.all if dtc.state]
        return confidence(
            {
                "dtcs": codes,
                "not_judged": not monitor.decisions.completed,
                "catalyst": monitor.catalyst.entry(),
                **self._evidence(),
            }
        )

    def _evidence(self) -> dict[str, Any]:
        return {"evidence": evidence_entry(self._monitor.decisions.facts.evidence())}

    def _now(self, tick: Tick) -> dict[str, Any]:
        monitor, sample = self._monitor, tick.sample
        return {
            "t0_ns": str(self._t0_ns),
            "ms": self._ms(sample.t_ns),
            "measured": _number(sample.values.item(self._output)),
            "predicted": _number(tick.predicted),
            "enabled": tick.enabled,
            "held": list(tick.conditions),
            "seen": self._conditions.seen(tick),
            "signals": signal_rows(monitor.names, sample, self._absent),
            "samples": monitor.samples,
            "enabled_samples": monitor.enabled_samples,
            "windows": self._counts,
            "completed": monitor.decisions.completed,
        }


def _numbers(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {k: _number(v) if isinstance(v, float) else v for k, v in fields.items()}


def _number(value: float) -> float | None:
    """Return the value rounded for JSON, None if it is not finite."""
    return round(value, 5) if math.isfinite(value) else None
