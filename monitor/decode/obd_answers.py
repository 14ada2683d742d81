"""Answers of OBD-II, service 01: ISO-TP reassembly, and the parameters (PIDs) in an answer.

Sources: ISO 15765-2 (frames), SAE J1979 (answers, and how many bytes a PID has).
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Final

import numpy as np

from monitor.base.types import Frame, FrameBlock
from monitor.frames.blocks import block_of, inserted

ANSWER: Final = 0x7E8
POSITIVE: Final = 0x41  # answer to service 01
N_BYTES: Final = {  # of the data of each PID of service 01
    pid: int(n)
    for pid, n in enumerate(
        "4422111111112111211122222222111242224444444411111221444444442222"
        "4422211111111224411222222211122141125253"
    )
} | {0x80: 4, 0xA0: 4, 0xC0: 4}


def answer_of(t_ns: int, pid: int, data: bytes) -> Frame:
    """Return the frame of an answer with one parameter."""
    return Frame(t_ns, ANSWER, False, bytes([len(data) + 2, POSITIVE, pid, *data]))


def with_all_parameters(blocks: Iterable[FrameBlock]) -> Iterator[FrameBlock]:
    """Yield blocks with a frame for each parameter of an answer, as if it were asked for alone.

    An answer whose bytes are not all told gives none; a run with --obd records such frames.
    """
    reassembly = Reassembly()
    for block in blocks:
        places, new = list[int](), list[Frame]()
        rows = np.flatnonzero(block.key == ANSWER)
        data = [block.data[row, : block.length[row]].tobytes() for row in rows]
        shown = set(zip(block.t_ns[rows].tolist(), data, strict=True))
        for row, each in zip(rows.tolist(), data, strict=True):
            answer = reassembly.push(each) or b""
            values = values_of(answer, N_BYTES, N_BYTES) if answer[:1] == bytes([POSITIVE]) else []
            if len(answer) != 1 + sum(1 + len(value) for _, value in values):
                continue
            for pid, value in values[each[0] < 8 :]:  # a single frame shows its first
                frame = answer_of(int(block.t_ns[row]), pid, value)
                if (frame.t_ns, frame.data) not in shown:
                    places.append(row + 1)
                    new.append(frame)
        yield inserted(block, places, block_of(new)) if new else block


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


def values_of(
    answer: bytes, asked: Collection[int], lengths: Mapping[int, int]
) -> list[tuple[int, bytes]]:
    """Return the PIDs of an answer with their data, up to the first unexpected or cut one.

    answer : bytes from the service number on
    """
    values: list[tuple[int, bytes]] = []
    rest = answer[1:]
    while rest and rest[0] in asked and len(rest) > lengths[rest[0]]:
        pid, end = rest[0], 1 + lengths[rest[0]]
        values.append((pid, rest[1:end]))
        rest = rest[end:]
    return values
