"""Answers of OBD-II, service 01: ISO-TP reassembly, and the parameters (PIDs) in an answer.

Sources: ISO 15765-2 (frames), SAE J1979 (answers, and how many bytes a PID has).
"""

from collections import defaultdict
from collections.abc import Collection
from typing import Final

import numpy as np

from monitor.base.types import Frame, FrameBlock
from monitor.frames.blocks import EXTENDED, block_of, chosen, frames_of, inserted

ANSWER: Final = 0x7E8
ANSWER_29: Final = EXTENDED | 0x18DAF100  # the last byte is the address of the ECU
POSITIVE: Final = 0x41  # answer to service 01
N_BYTES: Final = {  # of the data of each PID of service 01
    pid: int(n)
    for pid, n in enumerate(
        "4422111111112111211122222222111242224444444411111221444444442222"
        "4422211111111224411222222211122141125253"
    )
} | {0x80: 4, 0xA0: 4, 0xC0: 4}


class AllParameters:
    """Gives each parameter of an answer a frame, as if it were asked for alone.

    An answer whose bytes are not all told gives none. Beside it may stand such frames: a run with
    --obd recorded them.
    """

    def __init__(self) -> None:
        self._of_ecu = defaultdict[int, Reassembly](Reassembly)

    def push(self, block: FrameBlock) -> FrameBlock:
        """Return a block with these frames behind each answer."""
        places, new = list[int](), list[Frame]()
        rows = np.flatnonzero((block.key == ANSWER) | (block.key & ~np.uint32(0xFF) == ANSWER_29))
        frames = list(frames_of(chosen(block, rows)))
        shown = {(frame.t_ns, frame.data) for frame in frames}
        for row, frame in zip(rows.tolist(), frames, strict=True):
            answer = self._of_ecu[frame.can_id].push(frame.data) or b""
            values = values_of(answer, N_BYTES) if answer[:1] == bytes([POSITIVE]) else []
            if len(answer) != 1 + sum(1 + len(value) for _, value in values):
                continue
            for pid, value in values[frame.data[0] < 8 :]:  # a single frame shows its first
                own = frame._replace(data=bytes([len(value) + 2, POSITIVE, pid, *value]))
                if (own.t_ns, own.data) not in shown:
                    places.append(row + 1)
                    new.append(own)
        return inserted(block, places, block_of(new)) if new else block


class Reassembly:
    """Puts the frames of one answer together; an unexpected frame ends the answer."""

    def __init__(self) -> None:
        self.is_running = False  # True while consecutive frames are due
        self._data = bytearray()
        self._length = self._count = 0

    def push(self, data: bytes) -> bytes | None:
        """Take the bytes of a frame; return the answer when it is complete."""
        kind, low = (data[0] >> 4, data[0] & 0xF) if data else (-1, 0)
        if kind == 0:
            self.is_running = False
            return data[1 : 1 + low] if 1 <= low < len(data) else None
        if kind == 1 and len(data) == 8:
            self._length = low << 8 | data[1]
            self._data = bytearray(data[2:])
            self._count = 1
            self.is_running = self._length > 7
        elif kind == 2 and self.is_running and low == self._count & 0xF:
            self._data += data[1:]
            self._count += 1
            if len(self._data) >= self._length:
                self.is_running = False
                return bytes(self._data[: self._length])
        elif kind == 2:
            self.is_running = False  # a frame is missing
        return None


def values_of(answer: bytes, asked: Collection[int]) -> list[tuple[int, bytes]]:
    """Return the PIDs of an answer with their data, up to the first unexpected or cut one.

    answer : bytes from the service number on; a PID that the standard lacks has all that is left
    """
    values: list[tuple[int, bytes]] = []
    rest = answer[1:]
    while rest and rest[0] in asked and len(rest) > (n := N_BYTES.get(rest[0], len(rest) - 1)):
        values.append((rest[0], rest[1 : 1 + n]))
        rest = rest[1 + n :]
    return values
