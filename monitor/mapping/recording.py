"""The evidence of a recording: the values of candidates, and what guards their messages."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database, Message, Signal

from monitor.base.errors import SignalMapError
from monitor.base.types import FrameBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.checksum import ALGORITHMS, payload_checksums
from monitor.decode.parameter_groups import is_any_source
from monitor.decode.payloads import Bytes, Payloads
from monitor.decode.plan import Plan
from monitor.decode.raw_values import bit_position
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.frames.blocks import joined
from monitor.mapping.candidates import MapCandidate, Ranked
from monitor.mapping.fit import FEW

CONSIDERED: Final = 8  # candidates of each signal that are compared with the recording
BLOCKS: Final = 64  # of a million frames and more
NEARLY_ALL: Final = 0.95  # of the frames in which a counter counts or a checksum holds
COUNTER_BITS: Final = range(2, 9)


class ObservedSignal:
    """What a recording shows of the candidates that can be decoded."""

    def __init__(self, block: FrameBlock, decoder: BlockDecoder) -> None:
        self._block, self._plans = block, {p.name: p for p in decoder.plans.values()}
        t_s = (block.t_ns - block.t_ns[:1]) / 1e9
        self._series = {  # place → times in s, the database's values
            decoder.names[index]: (t_s[part.rows], values)
            for part in decoder.push(block)
            for index, values in zip(part.channels, part.values, strict=True)
        }

    def reranked(self, ranked: Ranked) -> dict[str, list[MapCandidate]]:
        """Return the candidates as the recording bears them out, the likeliest first."""
        return {
            name: sorted((self._seen(c) for c in each[:CONSIDERED]), key=lambda c: c.rank)
            for name, each in ranked.items()
        }

    def guards(self, messages: Iterable[str]) -> dict[str, Integrity]:
        """Return the counters and checksums that hold in messages, by their names."""
        names = sorted(self._plans.keys() & {*messages})
        found = ((name, self._integrity(self._plans[name])) for name in names)
        return {name: own for name, own in found if own.counter or own.checksum}

    def _seen(self, candidate: MapCandidate) -> MapCandidate:
        t_s, values = self._series.get(candidate.place, (np.empty(0), np.empty(0)))
        interval_s = float(np.percentile(np.diff(t_s), 95.0)) if len(t_s) >= FEW else None
        return candidate.seen(values, interval_s)

    def _integrity(self, plan: Plan) -> Integrity:
        """Return what guards a message: by its frames, whatever the names are."""
        mask, wanted = plan.match
        rows = ((self._block.key & mask) == wanted) & (self._block.length == plan.size)
        data, message = plan.payload(self._block.data[rows]), plan.message
        if len(data) < FEW or plan.is_multiplexed:
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


def observe(
    blocks: Iterable[FrameBlock], ranked: Ranked, dbc: Path, database: Database
) -> ObservedSignal:
    """Return what the first blocks of a recording show of the likeliest candidates."""
    every = {c.place: c for each in ranked.values() for c in each[:CONSIDERED]}
    return ObservedSignal(joined(list(islice(blocks, BLOCKS))), _decoder(every, dbc, database))


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


def _counts(message: Message, signal: Signal, data: Bytes) -> bool:
    """Return whether a signal goes up by one, wrapping round, in nearly all frames."""
    if signal.length not in COUNTER_BITS:
        return False
    steps = np.diff(Payloads(message, data).raw(signal)) & np.uint64((1 << signal.length) - 1)
    return bool((steps == 1).mean() >= NEARLY_ALL)
