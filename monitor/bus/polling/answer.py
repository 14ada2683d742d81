"""Requests of OBD-II, and identifiers of tester and ECU.

Sources: ISO 15765-2 (flow control), ISO 15765-4 (identifiers), SAE J1979 (service $01).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from monitor.base.errors import UsageError

SERVICE: Final = 0x01
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
    physical: int  # to one ECU alone, for flow control
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

    @classmethod
    def answering(cls, text: str) -> "EcuAddress":
        """Return the address of an ECU beside the engine's by its answers, in hexadecimal.

        Raises UsageError unless the identifier is 7E9 to 7EF or 18DAF1xx, or if it is the engine's.

        >>> hex(EcuAddress.answering("18DAF1A5").physical)
        '0x18daa5f1'
        """
        if re.fullmatch(r"(?i)(0x)?7E[9A-F]", text):
            return cls.of(int(text, 16) - 8)
        long = re.fullmatch(r"(?i)(?:0x)?18DAF1([0-9A-F]{2})", text)
        ecu = int(long[1], 16) if long else _ENGINE_29
        if ecu not in (_ENGINE_29, 0x11, 0x33, _TESTER_29):  # engines, all ECUs, the tester
            return cls.of(_pair_29(ecu)[0])
        raise UsageError(
            f"diagnostics identifier {text!r}: wanted 7E9 to 7EF (7E8 is the engine's), or "
            "18DAF1xx with xx none of 10, 11, 33 and F1"
        )

    @property
    def functional(self) -> int:
        """Return the identifier of requests to all ECUs."""
        return FUNCTIONAL_29 if self.is_extended else FUNCTIONAL


def _pair_29(ecu: int) -> tuple[int, int]:
    return 0x18DA0000 | ecu << 8 | _TESTER_29, 0x18DA0000 | _TESTER_29 << 8 | ecu


def request_of(pids: Sequence[int]) -> bytes:
    """Return the payload of a request for up to six PIDs.

    >>> request_of([0x0C, 0x0D]).hex(" ")
    '03 01 0c 0d 00 00 00 00'
    """
    return bytes([len(pids) + 1, SERVICE, *pids]).ljust(8, PADDING)


def supported(bitmap: int, data: bytes) -> set[int]:
    """Return the PIDs that a support bitmap marks.

    >>> sorted(supported(0x20, bytes([0x80, 0, 0, 1])))
    [33, 64]
    """
    bits = int.from_bytes(data, "big")
    return {bitmap + n for n in range(1, 33) if bits >> (32 - n) & 1}
