"""Answers to OBD-II requests: ISO-TP reassembly, and the values in an answer.

Sources: ISO 15765-2 (frames, flow control), ISO 15765-4 (identifiers), SAE J1979 (service $01).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from monitor.base.errors import UsageError

SERVICE: Final = 0x01
POSITIVE: Final = SERVICE + 0x40
NEGATIVE: Final = 0x7F
BUSY: Final = 0x21  # busy, repeat the request
PENDING: Final = 0x78  # the answer comes later
PADDING: Final = b"\0"
FLOW_CONTROL: Final = bytes([0x30, 0, 0]).ljust(8, PADDING)  # send all, without a pause
FUNCTIONAL: Final = 0x7DF
FUNCTIONAL_29: Final = 0x18DB33F1
_TESTER_29: Final = 0xF1
_ENGINE_29: Final = 0x10


@dataclass(frozen=True, slots=True)
class EcuAddress:
    """Identifiers of one tester and one ECU."""

    request: int  # to one ECU, or to all (functional)
    physical: int  # to the engine alone, for flow control
    response: int
    is_extended: bool = False

    @classmethod
    def of(cls, request: int) -> "EcuAddress":
        """Return the address for a request identifier.

        Raises UsageError if ISO 15765-4 does not define the identifier.
        """
        if request == FUNCTIONAL:
            return cls(request, 0x7E0, 0x7E8)
        if 0x7E0 <= request <= 0x7E7:
            return cls(request, request, request + 8)
        if request == FUNCTIONAL_29:
            return cls(request, *_pair_29(_ENGINE_29), True)
        ecu = request >> 8 & 0xFF
        if request == _pair_29(ecu)[0] and ecu != _TESTER_29:
            return cls(request, *_pair_29(ecu), True)
        raise UsageError(
            f"0x{request:X} is no identifier of an OBD-II request: 7DF, 7E0 to 7E7, 18DB33F1 and "
            "18DAxxF1 are"
        )


def _pair_29(ecu: int) -> tuple[int, int]:
    return 0x18DA0000 | ecu << 8 | _TESTER_29, 0x18DA0000 | _TESTER_29 << 8 | ecu


def request_of(pids: Sequence[int]) -> bytes:
    """Return the payload of a request for up to six PIDs.

    >>> request_of([0x0C, 0x0D]).hex(" ")
    '03 01 0c 0d 00 00 00 00'
    """
    return bytes([len(pids) + 1, SERVICE, *pids]).ljust(8, PADDING)


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
    answer: bytes, asked: Sequence[int], lengths: Mapping[int, int]
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


def supported(bitmap: int, data: bytes) -> set[int]:
    """Return the PIDs that a support bitmap marks.

    >>> sorted(supported(0x20, bytes([0x80, 0, 0, 1])))
    [33, 64]
    """
    bits = int.from_bytes(data, "big")
    return {bitmap + n for n in range(1, 33) if bits >> (32 - n) & 1}
