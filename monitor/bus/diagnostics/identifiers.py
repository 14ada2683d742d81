"""Data identifiers of UDS service 0x22: identification, and the monitor's present state.

Numbers 0xF1xx are those of ISO 14229-1; 0xFDxx are defined here. Values are big endian. A
floating-point number has four bytes (IEEE 754) and is NaN if there is no value.
"""

import struct
from collections.abc import Callable, Mapping
from typing import Final

from monitor.bus.diagnostics.state import State
from monitor.bus.transmit import VERDICTS

NO_VERDICT: Final = 0xFF


def _float(value: float) -> bytes:
    return struct.pack(">f", value)


def _count(value: int) -> bytes:
    return struct.pack(">I", value & 0xFFFFFFFF)


def _conditions(state: State) -> bytes:
    """Return the enable conditions that hold, as bits; the first is bit 0."""
    held = state.tick.conditions if state.tick else ()
    return struct.pack(">I", sum(holds << bit for bit, holds in enumerate(held)))


def _verdict(state: State) -> bytes:
    """Return verdict, mean and standard deviation of the last window's residual."""
    window = state.window
    if window is None:
        return struct.pack(">Bff", NO_VERDICT, float("nan"), float("nan"))
    return struct.pack(">Bff", VERDICTS[window.outcome], window.mean, window.std)


IDENTIFIERS: Final[Mapping[int, Callable[[State], bytes | None]]] = {
    0xF186: lambda s: bytes((s.session,)),
    0xF18A: lambda _: b"o2-monitor",
    0xF190: lambda s: s.identity.vin.encode() if s.identity.vin else None,
    0xF195: lambda s: s.identity.version.encode(),
    0xF197: lambda _: b"oxygen sensor monitor",
    0xFD00: lambda s: bytes.fromhex(s.identity.model_sha256),
    0xFD01: lambda s: s.identity.model_name.encode()[:64],
    0xFD02: lambda s: _float(s.measured),
    0xFD03: lambda s: _float(s.predicted),
    0xFD04: lambda s: _float(s.measured - s.predicted),
    0xFD05: lambda s: bytes((s.tick is not None and s.tick.enabled,)),
    0xFD06: _conditions,
    0xFD07: lambda s: _count(s.windows),
    0xFD08: _verdict,
    0xFD09: lambda s: _count(s.samples) + _count(s.enabled_samples),
    0xFD0A: lambda s: bytes((s.store.fault_flag | s.store.mil << 1,)),
    0xFD0B: lambda s: _count(s.ignored_frames) + _count(s.failed_transfers),
}
