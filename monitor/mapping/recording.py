"""The evidence of a recording: the values of candidates, and what guards their messages."""

from collections.abc import Collection, Iterable
from itertools import compress, islice
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database

from monitor.base.types import FrameBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusChannel, BusMap
from monitor.decode.checksum import ALGORITHMS, payload_checksums
from monitor.decode.parameter_groups import is_any_source
from monitor.decode.payloads import Fields
from monitor.decode.plan import Plan
from monitor.decode.raw_values import bit_position, last_byte
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.frames.blocks import joined
from monitor.mapping.candidates import Observed, mappable
from monitor.mapping.fit import FEW

BLOCKS: Final = 64  # of a million frames and more
NEARLY_ALL: Final = 0.95  # of the frames in which a counter counts or a checksum holds


class ShownSignals:
    """What the first blocks of a recording show of some signals.

    places : the signals, by message and name
    """

    def __init__(
        self, blocks: Iterable[FrameBlock], places: Collection[str], dbc: Path, database: Database
    ) -> None:
        channels = {
            place: BusChannel(
                mapped=MappedSignal(place, message.name, signal.name),
                message=message,
                signal=signal,
                integrity=Integrity(),
                dbc=dbc,
                map_path=dbc,
                any_source=is_any_source(message, database),
            )
            for place, message, signal in mappable(database)
            if place in places
        }
        names = tuple(channels)
        decoder = BlockDecoder(BusMap(((dbc, dbc),), channels, {}, names), names)
        block = joined(list(islice(blocks, BLOCKS)))
        t_s = (block.t_ns - block.t_ns[:1]) / 1e9
        self._block, self._channels = block, channels
        self._plans = {plan.name: plan for plan in decoder.plans.values()}
        self.observed: dict[str, Observed] = dict.fromkeys(channels, (np.empty(0), None))
        for part in decoder.push(block):
            is_known = len(part.rows) >= FEW
            interval_s = float(np.percentile(np.diff(t_s[part.rows]), 95.0)) if is_known else None
            for index, values in zip(part.channels, part.values, strict=True):
                self.observed[decoder.names[index]] = values, interval_s

    def guards(self, places: Collection[str]) -> dict[str, dict[str, str]]:
        """Return what guards the messages of some signals, as a signal map has it."""
        names = sorted({self._channels[place].message.name for place in places})
        return {name: held for name in names if (held := self._guard(self._plans[name]))}

    def _guard(self, plan: Plan) -> dict[str, str]:
        """Return the counter and the checksum that hold in a message, whatever the names are."""
        mask, wanted = plan.match
        rows = ((self._block.key & mask) == wanted) & (self._block.length == plan.size)
        data, message = self._block.data[rows][:, : plan.size], plan.message
        if len(data) < FEW or plan.is_multiplexed:
            return {}
        short = (s for s in message.signals if 1 < s.length <= 8 and not s.is_signed)
        plain = [s for s in short if last_byte(message, s) < plan.size]
        # a counter goes up by one, wrapping round, in nearly all frames
        raw, _ = Fields((message, s) for s in plain).read(data)
        rises = np.diff(raw) % np.array([1 << s.length for s in plain]).reshape(-1, 1) == 1
        counting = compress(plain, rises.mean(axis=1) >= NEARLY_ALL)
        counters = ({"counter": s.name} for s in counting)
        checksums = (
            {"checksum": s.name, "algorithm": algorithm}
            for s in plain
            if s.length == 8 and bit_position(message, s) % 8 == 0
            for algorithm in ALGORITHMS
            for sums in [payload_checksums(algorithm, message.frame_id, data, s.start // 8)]
            if (sums == data[:, s.start // 8]).mean() >= NEARLY_ALL
        )
        return next(counters, {}) | next(checksums, {})
