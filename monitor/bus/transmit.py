"""The CAN messages that the monitor sends: fault flag, codes and the last window."""

import math
from collections.abc import Sequence
from typing import Final

from cantools.database.can import Message

import dbc
from monitor.base.types import Frame
from monitor.bus.attachment import Attachment
from monitor.decode.bus_map import load_database
from monitor.decode.checksum import payload_checksum
from monitor.memory.dtc import Status
from monitor.pipeline.events import Event, Tick, WindowJudged
from monitor.pipeline.monitor import SensorMonitor

STATUS_PERIOD_NS: Final = 100_000_000
CHECKSUM_BYTE: Final = 7
_LETTERS: Final = "PCBU"


def dtc_number(code: str) -> int:
    """Return a trouble code as a number of two bytes (SAE J2012).

    >>> hex(dtc_number("P0133")), hex(dtc_number("U0100"))
    ('0x133', '0xc100')
    """
    return _LETTERS.index(code[0]) << 14 | int(code[1], 16) << 12 | int(code[2:], 16)


class Transmitter(Attachment):
    """Turns events into the frames of ``o2_monitor.dbc``; their times are those of the samples."""

    def __init__(self, monitor: SensorMonitor) -> None:
        database = load_database(dbc.path("o2_monitor.dbc"))
        self._monitor = monitor
        self._status = database.get_message_by_name("O2MON_Status")
        self._window = database.get_message_by_name("O2MON_Window")
        self._counters = {self._status.name: 0, self._window.name: 0}
        self._next_ns = 0
        self._ready: list[Frame] = []

    def push(self, event: Event) -> None:
        """Make the frames that are due at this event."""
        if isinstance(event, WindowJudged):
            self._ready.append(self._frame(self._window, event.window.t_end_ns, _fields(event)))
        elif isinstance(event, Tick) and self._is_due(event.sample.t_ns):
            self._next_ns = event.sample.t_ns + STATUS_PERIOD_NS
            self._ready.append(self._frame(self._status, event.sample.t_ns, self._state(event)))

    def work(self, now_s: float) -> Sequence[Frame]:
        """Return the frames made since the last call."""
        ready, self._ready = self._ready, []
        return ready

    def _is_due(self, t_ns: int) -> bool:
        """Return whether a status is due, or the clock has stepped back."""
        return not self._next_ns - STATUS_PERIOD_NS <= t_ns < self._next_ns

    def _state(self, tick: Tick) -> dict[str, float | str]:
        active = self._monitor.store.active
        first = active[0] if active else None
        return {
            "FaultFlag": int(self._monitor.store.fault_flag),
            "WarningLamp": int(any(d.status & Status.WARNING_INDICATOR for d in active)),
            "MonitorState": self._monitor_state(tick),
            "DtcCount": len(active),
            "EnabledPercent": 100 * self._monitor.enabled_samples // self._monitor.samples,
            "Dtc": dtc_number(first.code) if first else 0,
            "DtcStatus": int(first.status) if first else 0,
        }

    def _monitor_state(self, tick: Tick) -> str:
        if self._monitor.store.fault_flag:
            return "failed"
        if self._monitor.decisions.completed:
            return "passed"
        if math.isnan(tick.predicted):
            return "no signals"
        return "monitoring" if tick.enabled else "not enabled"

    def _frame(self, message: Message, t_ns: int, values: dict[str, float | str]) -> Frame:
        counter = self._counters[message.name]
        self._counters[message.name] = (counter + 1) % 16
        fields = values | {"AliveCounter": counter, "Checksum": 0}
        for signal in message.signals:  # a number beyond the range is sent as its limit
            if not isinstance(value := fields[signal.name], str):
                fields[signal.name] = min(max(value, signal.minimum or 0), signal.maximum or 0)
        payload = bytearray(message.encode(fields, strict=False))
        payload[CHECKSUM_BYTE] = payload_checksum(
            "crc8_sae_j1850_id", message.frame_id, bytes(payload), CHECKSUM_BYTE
        )
        return Frame(t_ns, message.frame_id, message.is_extended_frame, bytes(payload))


def _fields(event: WindowJudged) -> dict[str, float | str]:
    return {
        "WindowIndex": event.window.index % 65536,
        "ResidualMean": event.mean,
        "ResidualStd": event.std,
        "Verdict": event.outcome,
    }
