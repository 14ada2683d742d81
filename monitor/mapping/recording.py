"""The evidence of a recording: the values of candidates, and what guards their messages."""

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database, Message, Signal

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


class ObservedSignals:
    """What the first blocks of a recording show of the likeliest candidates."""

    def __init__(
        self, blocks: Iterable[FrameBlock], ranked: Ranked, dbc: Path, database: Database
    ) -> None:
        channels = {
            each.place: BusChannel(
                mapped=MappedSignal(each.place, each.message.name, each.signal.name),
                message=each.message,
                signal=each.signal,
                integrity=Integrity(),
                dbc=dbc,
                map_path=dbc,
                any_source=is_any_source(each.message, database),
            )
            for candidates in ranked.values()
            for each in candidates[:CONSIDERED]
        }
        bus_map = BusMap(((dbc, dbc),), channels, {}, tuple(channels))
        decoder = BlockDecoder(bus_map, bus_map.names)
        block = joined(list(islice(blocks, BLOCKS)))
        t_s = (block.t_ns - block.t_ns[:1]) / 1e9
        self._block, self._ranked = block, ranked
        self._plans = {plan.name: plan for plan in decoder.plans.values()}
        self._series = {  # place → times in s, the database's values
            decoder.names[index]: (t_s[part.rows], values)
            for part in decoder.push(block)
            for index, values in zip(part.channels, part.values, strict=True)
        }

    def reranked(self) -> dict[str, list[MapCandidate]]:
        """Return the candidates as the recording bears them out, the likeliest first."""
        return {
            name: sorted((self._seen(c) for c in each[:CONSIDERED]), key=lambda c: c.rank)
            for name, each in self._ranked.items()
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
        checksums = (
            (s.name, algorithm)
            for s in plain
            if s.length == 8 and bit_position(message, s) % 8 == 0
            for algorithm in ALGORITHMS
            for sums in [payload_checksums(algorithm, message.frame_id, data, s.start // 8)]
            if (sums == data[:, s.start // 8]).mean() >= NEARLY_ALL
        )
        return Integrity(counter, *next(checksums, ()))


def _counts(message: Message, signal: Signal, data: Bytes) -> bool:
    """Return whether a signal goes up by one, wrapping round, in nearly all frames."""
    if signal.length not in COUNTER_BITS:
        return False
    steps = np.diff(Payloads(message, data).raw(signal)) & np.uint64((1 << signal.length) - 1)
    return bool((steps == 1).mean() >= NEARLY_ALL)
