"""The evidence of a recording: the values of candidates, and what guards their messages."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.types import FloatArray, FrameBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.checksum import ALGORITHMS, payload_checksums
from monitor.decode.parameter_groups import is_any_source
from monitor.decode.payloads import Bytes, Payloads
from monitor.decode.raw_values import bit_position
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.frames.blocks import chosen
from monitor.mapping.candidates import MapCandidate, Ranked
from monitor.mapping.fit import FEW

CONSIDERED: Final = 8  # candidates of each signal that are compared with the recording
MOST_FRAMES: Final = 2_000_000
NEARLY_ALL: Final = 0.95  # of the frames in which a counter counts or a checksum holds
COUNTER_BITS: Final = range(2, 9)


@dataclass(frozen=True, slots=True)
class ObservedSignal:
    """What a recording shows."""

    series: Mapping[str, tuple[FloatArray, FloatArray]]  # place → times in s, database's values
    payloads: Mapping[str, tuple[Message, Bytes]]  # by the message's name, of its length

    def reranked(self, ranked: Ranked) -> dict[str, list[MapCandidate]]:
        """Return the candidates as the recording bears them out, the likeliest first."""
        return {
            name: sorted((self._seen(c) for c in each[:CONSIDERED]), key=lambda c: c.rank)
            for name, each in ranked.items()
        }

    def guards(self, messages: Iterable[str]) -> dict[str, Integrity]:
        """Return the counters and checksums that hold in messages, by their names."""
        found = ((name, _integrity(*self.payloads[name])) for name in sorted({*messages}))
        return {name: own for name, own in found if own.counter or own.checksum}

    def _seen(self, candidate: MapCandidate) -> MapCandidate:
        t_s, values = self.series.get(candidate.place, (np.empty(0), np.empty(0)))
        interval_s = float(np.percentile(np.diff(t_s), 95.0)) if len(t_s) >= FEW else None
        return candidate.seen(values, interval_s)


def observe(
    blocks: Iterable[FrameBlock], ranked: Ranked, dbc: Path, database: Database
) -> ObservedSignal:
    """Return what a recording shows of the likeliest candidates that can be decoded."""
    every = {c.place: c for each in ranked.values() for c in each[:CONSIDERED]}
    decoder = _decoder(every, dbc, database)
    nothing = np.empty(0)
    series = {place: [(nothing, nothing)] for place in every}
    payloads = {c.message.name: [np.empty((0, c.message.length), np.uint8)] for c in every.values()}
    first_ns, n = None, 0
    for whole in blocks:
        block = chosen(whole, slice(0, MOST_FRAMES - n))
        n += len(block.t_ns)
        first_ns = block.t_ns[:1] if first_ns is None else first_ns
        for plan in decoder.plans.values():
            mask, wanted = plan.match
            whole_ones = ((block.key & mask) == wanted) & (block.length == plan.size)
            payloads[plan.name].append(plan.payload(block.data[whole_ones]))
        for part in decoder.push(block):
            t_s = (block.t_ns[part.rows] - first_ns) / 1e9
            for index, values in zip(part.channels, part.values, strict=True):
                series[decoder.names[index]].append((t_s, values))
        if n >= MOST_FRAMES:
            break
    messages = {c.message.name: c.message for c in every.values()}
    return ObservedSignal(
        {
            place: (np.concatenate([t for t, _ in each]), np.concatenate([v for _, v in each]))
            for place, each in series.items()
        },
        {name: (messages[name], np.concatenate(each)) for name, each in payloads.items()},
    )


def _decoder(every: Mapping[str, MapCandidate], dbc: Path, database: Database) -> BlockDecoder:
    """Return a decoder of those candidates that can be decoded, by their places."""

    def of(channels: dict[str, BusChannel]) -> BlockDecoder:
        return BlockDecoder(BusMap(((dbc, dbc),), channels, {}, tuple(channels)), tuple(channels))

    channels = {}
    for place, each in every.items():
        channel = BusChannel(
            mapped=MappedSignal(place, each.message.name, each.signal.name),
            message=each.message,
            signal=each.signal,
            integrity=Integrity(),
            dbc=dbc,
            map_path=dbc,
            any_source=is_any_source(each.message, database),
        )
        with suppress(SignalMapError, ValueError, OverflowError):
            of({place: channel})
            channels[place] = channel
    return of(channels)


def _integrity(message: Message, data: Bytes) -> Integrity:
    """Return what guards a message: by its frames, (n, n_bytes), whatever the names are."""
    if len(data) < FEW or message.is_multiplexed():
        return Integrity()
    plain = [s for s in message.signals if not (s.is_signed or s.is_float)]
    counter = next((s.name for s in plain if _counts(message, s, data)), "")
    for signal in plain:
        if signal.length == 8 and bit_position(message, signal) % 8 == 0:
            own = data[:, signal.start // 8]
            for algorithm in ALGORITHMS:
                sums = payload_checksums(algorithm, message.frame_id, data, signal.start // 8)
                if (sums == own).mean() >= NEARLY_ALL:
                    return Integrity(counter, signal.name, algorithm)
    return Integrity(counter)


def _counts(message: Message, signal: Signal, data: Bytes) -> bool:
    """Return whether a signal goes up by one, wrapping round, in nearly all frames."""
    if signal.length not in COUNTER_BITS:
        return False
    steps = np.diff(Payloads(message, data).raw(signal)) & np.uint64((1 << signal.length) - 1)
    return bool((steps == 1).mean() >= NEARLY_ALL)
