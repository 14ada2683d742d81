"""Recordings to CAN logs: any table through a DBC and a signal map.

Each message is sent at its cycle time (GenMsgCycleTime of the DBC) with the last row before the
frame: a zero-order hold. A canonical signal that the table lacks is sent as not available.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import can
import numpy as np
from cantools.database.can import Message

from monitor.base.errors import RecordingError, SignalMapError
from monitor.base.files.outputs import replaced
from monitor.base.types import FloatArray, FrameBlock, IntArray
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.signal_map import Integrity
from monitor.frames.blocks import EXTENDED, chosen, frames_of, joined
from monitor.frames.logs import log_kind
from monitor.frames.text.candump_lines import lines_of
from training.recordings.files.can_encoding import Payloads, encode_message
from training.recordings.files.mf4_log import write_mf4
from training.recordings.files.table_files import open_for_writing

DEFAULT_CYCLE_NS: Final = 20_000_000


@dataclass(frozen=True, slots=True)
class Outgoing:
    """One message of a bus map with the canonical signals that it carries.

    A multiplexed message is several: its groups of signals are sent in turn.
    """

    message: Message
    integrity: Integrity
    channels: tuple[BusChannel, ...]
    switches: tuple[tuple[str, int], ...] = ()  # multiplexers with their raw values
    turn: int = 0  # of the group among those of its message
    n_turns: int = 1

    @property
    def cycle_ns(self) -> int:
        """Return its cycle time; the message's is 20 ms where the DBC gives none."""
        return self._own_cycle_ns * self.n_turns

    @property
    def first_ns(self) -> int:
        """Return the time of its first frame after the first row."""
        return self._own_cycle_ns * self.turn

    @property
    def _own_cycle_ns(self) -> int:
        cycle_ms = self.message.cycle_time
        return round(cycle_ms * 1_000_000) if cycle_ms else DEFAULT_CYCLE_NS

    def encode(self, values: Mapping[str, FloatArray], n: int) -> Payloads:
        """Return ``n`` payloads, (n, length), from canonical values, each (n,); NaN is missing."""
        physical: dict[str, FloatArray] = {
            channel.signal.name: (values[channel.mapped.name] - channel.mapped.offset)
            / channel.mapped.factor
            for channel in self.channels
            if channel.mapped.name in values
        }
        for name, raw in self.switches:
            signal = self.message.get_signal_by_name(name)
            physical[name] = np.full(n, raw * float(signal.scale) + float(signal.offset))
        return encode_message(self.message, self.integrity, physical, n, self.turn, self.n_turns)


def outgoing(bus_map: BusMap, names: Container[str] = ()) -> tuple[Outgoing, ...]:
    """Return the messages that carry the mapped signals, in the order of their identifiers.

    names : signals that the vehicle has; an optional signal that is not among them is not sent
    """
    messages: dict[str, list[BusChannel]] = {}
    for channel in bus_map.channels.values():
        if not channel.mapped.is_optional or channel.mapped.name in names:
            messages.setdefault(channel.message.name, []).append(channel)
    found = [each for channels in messages.values() for each in _turns(channels)]
    return tuple(sorted(found, key=lambda each: each.message.frame_id))


def _turns(channels: Sequence[BusChannel]) -> list[Outgoing]:
    """Return the frames of one message: the groups of its signals, one for each switch."""
    message, integrity = channels[0].message, channels[0].integrity
    groups: dict[tuple[tuple[str, int], ...], list[BusChannel]] = {}
    for channel in channels:
        groups.setdefault(_switches(channel), []).append(channel)
    always = groups.pop((), []) if len(groups) > 1 else []
    return [
        Outgoing(message, integrity, (*always, *group), switches, turn, len(groups))
        for turn, (switches, group) in enumerate(groups.items())
    ]


def _switches(channel: BusChannel) -> tuple[tuple[str, int], ...]:
    """Return the multiplexers above a signal with the raw values under which it comes."""
    found, signal = [], channel.signal
    while signal.multiplexer_signal is not None:
        ids = signal.multiplexer_ids or [0]
        found.append((signal.multiplexer_signal, int(ids[0])))
        signal = channel.message.get_signal_by_name(signal.multiplexer_signal)
    return tuple(found)


def block_of(message: Message, times_ns: IntArray, payloads: Payloads) -> FrameBlock:
    """Return the frames of one message sent at ``times_ns``, (n,)."""
    n, length = payloads.shape
    keys = np.full(n, message.frame_id | message.is_extended_frame * EXTENDED, np.uint32)
    data = np.pad(payloads, ((0, 0), (0, 8 - length)))
    return FrameBlock(times_ns.astype(np.int64), keys, np.full(n, length, np.uint8), data)


def merge(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Return all frames in the order of time; at the same time the earlier block comes first."""
    if not blocks:
        raise RecordingError("there are no frames to write")
    frames = joined(blocks)
    return chosen(frames, np.argsort(frames.t_ns, kind="stable"))


def broadcast(
    bus_map: BusMap, t_ns: IntArray, values: Mapping[str, FloatArray], start_ns: int | None = None
) -> FrameBlock:
    """Return the frames that an ECU would send during the table.

    t_ns : (n,) strictly rising times of the rows
    values : canonical signals, each (n,); NaN is sent as not available
    start_ns : time of the first row on the log's clock, default the table's own
    The last row lasts one more row's time. A derived signal of the map is sent only as its sources,
    if the table has them.
    Raises SignalMapError if the map carries none of the signals.
    """
    messages = outgoing(bus_map, values)
    wanted = {channel.mapped.name for each in messages for channel in each.channels}
    if not wanted & values.keys():
        raise SignalMapError(
            f"{bus_map.pairs[-1][1]}: carries none of the table's signals {', '.join(values)}"
        )
    first_ns = int(t_ns[0])
    shift_ns = 0 if start_ns is None else start_ns - first_ns
    row_ns = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else DEFAULT_CYCLE_NS
    blocks = []
    for each in messages:
        begin_ns = first_ns + each.first_ns
        times_ns = np.arange(begin_ns, int(t_ns[-1]) + row_ns, each.cycle_ns, dtype=np.int64)
        rows = np.searchsorted(t_ns, times_ns, side="right") - 1
        held = {name: column[rows] for name, column in values.items() if name in wanted}
        payloads = each.encode(held, len(times_ns))
        blocks.append(block_of(each.message, times_ns + shift_ns, payloads))
    return merge(blocks)


def write_log(path: str | Path, frames: FrameBlock) -> None:
    """Write the frames to ``path`` in the format of its suffix; times are rounded to microseconds.

    Raises RecordingError if the format is unknown or cannot hold the frames, UsageError if the file
    cannot be written.
    """
    path = Path(path)
    kind = log_kind(path)
    frames = frames._replace(t_ns=(frames.t_ns + 500) // 1000 * 1000)
    try:
        with replaced(path) as begun:
            _write(begun, kind, frames)
    except (ValueError, NotImplementedError) as error:
        raise RecordingError(f"{path}: cannot write the log: {error}") from error


def _write(path: Path, kind: str, frames: FrameBlock) -> None:
    if kind == ".log":
        with open_for_writing(path) as file:
            file.write(lines_of(frames, "can0", ""))
        return
    if path.suffix.lower() == ".mf4":
        write_mf4(path, frames)
        return
    with can.Logger(path) as logger:
        for frame in frames_of(frames):
            logger.on_message_received(
                can.Message(
                    timestamp=frame.t_ns // 1000 / 1e6,
                    arbitration_id=frame.can_id,
                    is_extended_id=frame.is_extended,
                    data=frame.data,
                    channel=0,
                )
            )
