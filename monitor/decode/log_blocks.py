"""The frames that a bus map wants: of one channel of a log, engine answers under one identifier.

An engine with 29-bit diagnostics answers OBD requests as 18DAF1xx, xx its address (ISO 15765-4).
Such an answer has the bytes of one under 7E8, which maps name.
"""

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Message

from monitor.base.types import FrameBlock
from monitor.decode.bus_map import BusMap
from monitor.decode.obd_answers import ANSWER, ANSWER_29, AllParameters
from monitor.decode.parameter_groups import Sender
from monitor.frames.blocks import EXTENDED, LogCounters
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks

_ENGINE: Final = 0x10  # usual address of the engine's ECU


class EngineAnswers:
    """Gives the answers of one ECU, the engine's or the first that came, the 11-bit identifier.

    Each parameter of an answer gets a frame.

    keys : of the mapped messages' frames
    """

    def __init__(self, keys: Collection[int]) -> None:
        is_wanted = ANSWER in keys and ANSWER_29 | _ENGINE not in keys
        self.groups = ((0x18DAF100, 0x1FFFFF00),) * is_wanted  # identifiers of 29 bits, mask
        self._sender = Sender(_ENGINE)
        self._all = AllParameters() if ANSWER in keys else None

    def push(self, block: FrameBlock) -> FrameBlock:
        """Return a block with the answers among the 11-bit frames."""
        block = self._all.push(block) if self._all else block
        if not self.groups:
            return block
        rows = np.flatnonzero((block.key & ~np.uint32(0xFF)) == ANSWER_29)
        rows = rows[self._sender.takes((block.key[rows] & 0xFF).astype(np.int64))]
        key = block.key.copy() if len(rows) else block.key
        key[rows] = ANSWER
        return block._replace(key=key)


def log_blocks(
    path: str | Path, bus_map: BusMap, counters: LogCounters | None = None
) -> Iterator[FrameBlock]:
    """Return the blocks of a log for a bus map; errors as of ``read_blocks``.

    Raises RecordingError, too, if a mapped identifier is on two channels and none is chosen.
    """
    mapped = keys_of(channel.message for channel in bus_map.channels.values())
    blocks = read_blocks(path, counters, Channels(bus_map.log_channel, mapped))
    return map(EngineAnswers(mapped).push, blocks)


def keys_of(messages: Iterable[Message]) -> set[int]:
    """Return the keys of the messages' frames."""
    return {m.frame_id | (EXTENDED if m.is_extended_frame else 0) for m in messages}
