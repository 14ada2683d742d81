"""A monitor for programs that already listen on a bus with python-can."""

import logging
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import can

from monitor.api.recordings import Buses
from monitor.api.stream import Monitor
from monitor.api.verdict import Code, Verdict
from monitor.base.types import Frame
from monitor.bus.link.clock import Clock
from monitor.model.step import Model
from monitor.pipeline.events import DtcChanged

_LOG = logging.getLogger("o2_monitor")


class OxygenSensorMonitor(can.Listener):
    """A ``can.Listener`` that judges the sensor: ``can.Notifier(bus, [OxygenSensorMonitor()])``.

    model, buses, config, memory : as in ``replay``
    on_code : called with every code that becomes pending or confirmed, in the notifier's thread
    monotonic_s : clock that measures when a message arrives, in s

    A message's time is believed unless the clock says that it cannot be, as in ``o2mon run``. A
    bus that falls silent shows with its next message; call ``tick`` about twice a second where it
    must show before. An error in ``on_code`` is logged under ``o2_monitor`` and ends nothing: an
    exception would end python-can's thread for all listeners.

    >>> import can
    >>> with can.Bus("doctest", interface="virtual") as bus:
    ...     listener = OxygenSensorMonitor(on_code=print)
    ...     notifier = can.Notifier(bus, [listener], timeout=0.01)
    ...     notifier.stop()
    >>> listener.verdict.is_judged
    False
    """

    def __init__(
        self,
        model: str | Path | Model | None = None,
        *,
        buses: Buses = (),
        config: str | Path | None = None,
        memory: str | Path | None = None,
        series: bool = False,
        on_code: Callable[[Code], None] | None = None,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self.monitor = Monitor(model, buses=buses, config=config, memory=memory, series=series)
        self._on_code, self._now_s = on_code or (lambda _: None), monotonic_s
        store = self.monitor.judging.pipeline.monitor.store
        self._states: dict[str, str | None] = {dtc.code: dtc.state for dtc in store.active}
        self._clock = Clock(monotonic_s, min(self.monitor.judging.pipeline.decoder.timeouts_ns))
        self._lock = threading.Lock()  # the notifier's thread writes, another one may read

    def on_message_received(self, msg: can.Message) -> None:
        """Judge one message; a message that cannot be used is counted."""
        with self._lock:
            frame = self.monitor.usable(msg)
            codes = self._taken([] if frame is None else self._clock.weighed(frame, self._now_s()))
        self._tell(codes)

    def tick(self) -> None:
        """Let time go on while no message comes."""
        with self._lock:
            mark = self._clock.mark()
            codes = self._taken([] if mark is None else [mark])
        self._tell(codes)

    def on_error(self, exc: Exception) -> None:
        """Log an error of the bus."""
        _LOG.error("bus: %s", exc)

    def stop(self) -> None:
        """Store and close the fault memory; the notifier calls it at its end."""
        with self._lock:
            self.monitor.close()

    @property
    def verdict(self) -> Verdict:
        """Return the verdict so far."""
        with self._lock:
            verdict = self.monitor.verdict
            counters = verdict.entry["counters"] | self._clock.counters.found
        return Verdict({**verdict.entry, "counters": counters}, verdict.series)

    def _taken(self, frames: Iterable[Frame]) -> list[Code]:
        """Judge frames; return the codes that become pending or confirmed."""
        new = set[str]()
        for event in (each for frame in frames for each in self.monitor.take(frame)):
            if isinstance(event, DtcChanged):
                dtc, before = event.dtc, self._states.get(event.dtc.code)
                self._states[dtc.code] = dtc.state
                new |= {dtc.code} if dtc.state not in (None, before) else set()
        return [code for code in self.monitor.verdict.codes if code.code in new] if new else []

    def _tell(self, codes: Iterable[Code]) -> None:
        """Pass codes on, without the lock: the verdict may be read meanwhile."""
        for code in codes:
            try:
                self._on_code(code)
            except Exception:
                _LOG.exception("on_code failed")
