"""The signals of a database that can be mapped, and what a recording shows of them."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from itertools import compress, islice
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
from monitor.decode.payloads import Fields
from monitor.decode.plan import Plan
from monitor.decode.raw_values import bit_position, last_byte
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.decode.soundness import check_message, check_signal
from monitor.frames.blocks import joined
from monitor.mapping.fit import FEW

BLOCKS: Final = 64  # of a million frames and more
NEARLY_ALL: Final = 0.95  # of the frames in which a counter counts or a checksum holds

# values in the database's unit, and how far apart they are in s: 95 % are closer; None of few
Observed = tuple[FloatArray | None, float | None]


def mappable(database: Database) -> Iterator[tuple[str, Message, Signal]]:
    """Yield the signals with which a map can be loaded, behind message and name."""
    for message in database.messages:
        names = Counter(signal.name for signal in message.signals)  # alike: not told apart
        for signal in message.signals:
            try:
                check_message(Path(), message)
                check_signal(Path(), message, signal.name)
            except SignalMapError:
                continue
            if names[signal.name] == 1 and not signal.is_multiplexer and signal.length <= 64:
                yield f"{message.name}.{signal.name}", message, signal


class ShownSignals:
    """What the first blocks of a recording show of some signals.

    places : the signals, by message and name
    """

    def __init__(
        self, blocks: Iterable[FrameBlock], places: Collection[str], database: Database
    ) -> None:
        channels, no_file = dict[str, BusChannel](), Path()
        for place, message, signal in mappable(database):
            if place in places:
                mapped = MappedSignal(place, message.name, signal.name)
                parts = mapped, message, signal, Integrity(), no_file, no_file
                channels[place] = BusChannel(*parts, any_source=is_any_source(message, database))
        names = tuple(channels)
        decoder = BlockDecoder(BusMap((), channels, {}, names), names)
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
