"""The frames of a log as a bus map wants them: of one channel, engine answers under one identifier.

An engine with 29-bit diagnostics answers OBD requests as 18DAF1xx, xx its address (ISO 15765-4).
Such an answer has the bytes of one under 7E8, which maps name.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Message

from monitor.base.types import FrameBlock
from monitor.decode.bus_map import BusMap
from monitor.frames.blocks import EXTENDED, LogCounters
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks

_ANSWER: Final = 0x7E8
_ANSWER_29: Final = EXTENDED | 0x18DAF100
_ADDRESS: Final = 0xFF
_ENGINE: Final = 0x10  # usual address of the engine's ECU


def log_blocks(
    path: str | Path, bus_map: BusMap, counters: LogCounters | None = None
) -> Iterator[FrameBlock]:
    """Return the blocks of a log for a bus map; errors as of ``read_blocks``.

    Raises RecordingError, too, if a mapped identifier is on two channels and none is chosen.
    """
    keys = keys_of(channel.message for channel in bus_map.channels.values())
    blocks = read_blocks(path, counters, Channels(bus_map.log_channel, keys))
    return _standard(blocks) if _ANSWER in keys and _ANSWER_29 | _ENGINE not in keys else blocks


def keys_of(messages: Iterable[Message]) -> set[int]:
    """Return the keys of the messages' frames."""
    return {m.frame_id | (EXTENDED if m.is_extended_frame else 0) for m in messages}


def _standard(blocks: Iterator[FrameBlock]) -> Iterator[FrameBlock]:
    """Give the answers of one ECU, the engine's or the first that came, the 11-bit identifier."""
    address: int | None = None
    for block in blocks:
        rows = np.flatnonzero((block.key & ~np.uint32(_ADDRESS)) == _ANSWER_29)
        senders = block.key[rows] & _ADDRESS
        if len(rows) and address != _ENGINE:
            address = _ENGINE if (senders == _ENGINE).any() else int(address or senders[0])
        rows = rows[senders == address] if address is not None else rows
        key = block.key.copy() if len(rows) else block.key
        key[rows] = _ANSWER
        yield block._replace(key=key)
