"""The simulated ECU on the bus: messages at their cycle times, with jitter and quantisation.

Log and table of a drive hold the same values: the table equals the samples that the monitor
assembles from the frames of the log.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

import dbc
from monitor.base.faults import Fault
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, FrameBlock, IntArray, SampleBlock
from monitor.decode.bus_map import BusChannel, BusMap, load_pairs
from monitor.grid.block_assembler import assemble_arrays
from training.dyno.cycles import STEP_S
from training.recordings.files.can_log import Outgoing, block_of, merge, outgoing

STEP_NS: Final = round(STEP_S * 1e9)
JITTER_NS: Final = 400_000  # standard deviation of a frame's send time
LAMBDA_MESSAGE: Final = "ECU_Lambda"


@dataclass(frozen=True, slots=True)
class Broadcast:
    """Send times and values of one message over a whole drive."""

    outgoing: Outgoing
    times_ns: IntArray  # (n,) rising, multiples of 1000 ns
    values: dict[str, FloatArray]  # canonical name → (n,) before quantisation


def own_bus() -> BusMap:
    """Return the bus map of the project's ECU."""
    return load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])


def broadcast(
    signals: Mapping[str, FloatArray],
    bus_map: BusMap,
    rng: np.random.Generator,
    fault: Fault | None = None,
    fault_start_s: float = 0.0,
) -> list[Broadcast]:
    """Return every message of the drive with its send times and values.

    signals : canonical name → (n,) at 100 Hz
    rng : draws phase and jitter of the messages
    fault : the fault signal_missing stops the lambda message at ``fault_start_s``
    """
    n = len(next(iter(signals.values())))
    messages = []
    for planned in outgoing(bus_map, signals):
        start_ns = int(rng.integers(0, planned.cycle_ns // 1000)) * 1000
        times_ns = np.arange(start_ns, (n - 1) * STEP_NS, planned.cycle_ns)
        jitter_ns = np.clip(rng.standard_normal(len(times_ns)), -5.0, 5.0) * JITTER_NS
        times_ns = np.maximum(times_ns + np.rint(jitter_ns / 1000).astype(np.int64) * 1000, 0)
        if fault is not None and fault.missing and planned.message.name == LAMBDA_MESSAGE:
            times_ns = times_ns[times_ns < fault_start_s * 1e9]
        names = [channel.mapped.name for channel in planned.channels]
        values = {name: signals[name][times_ns // STEP_NS] for name in names}
        messages.append(Broadcast(planned, times_ns, values))
    return messages


def frames(messages: list[Broadcast]) -> FrameBlock:
    """Return the frames of the drive in time order."""
    return merge(
        [
            block_of(b.outgoing.message, b.times_ns, b.outgoing.encode(b.values, len(b.times_ns)))
            for b in messages
        ]
    )


def names_of(messages: list[Broadcast], bus_map: BusMap) -> tuple[str, ...]:
    """Return the names of the drive's samples: those of every vehicle, then its own."""
    own = {name for b in messages for name in b.values}
    return (*bus_map.names, *(name for name in bus_map.optional if name in own))


def samples(messages: list[Broadcast], bus_map: BusMap, period_ns: int) -> SampleBlock:
    """Return the samples that the monitor assembles from the frames of the drive.

    The columns have the order of ``names_of``.
    """
    names = names_of(messages, bus_map)
    series = {
        channel.mapped.name: (b.times_ns, _as_read(channel, b.values[channel.mapped.name]))
        for b in messages
        for channel in b.outgoing.channels
    }
    return assemble_arrays(
        np.sort(np.concatenate([b.times_ns for b in messages])),
        [series[name] for name in names],
        names,
        names,
        period_ns=period_ns,
        timeouts_ns=[round(bus_map.channels[n].mapped.timeout_s * 1e9) for n in names],
    )


def _as_read(channel: BusChannel, values: FloatArray) -> FloatArray:
    """Return the values after quantisation, infinite if the decoder rejects them."""
    scale, offset = float(channel.signal.scale), float(channel.signal.offset)
    read = np.rint((values - offset) / scale) * scale + offset
    low, high = plausible_range(channel.mapped.name)
    read[(read < low) | (read > high)] = np.inf
    return read
