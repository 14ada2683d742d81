"""Checksums of CAN payloads.

CRC8 SAE J1850: polynomial 0x1D, initial value 0xFF, not reflected, final XOR 0xFF. The project's
ECU protects each message over the low byte of its identifier, then all payload bytes but the
checksum's own, in their order; so a frame under a wrong identifier does not pass.
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

POLYNOMIAL: Final = 0x1D
INITIAL: Final = 0xFF
FINAL_XOR: Final = 0xFF


def _table() -> bytes:
    entries = bytearray()
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = ((crc << 1) ^ POLYNOMIAL if crc & 0x80 else crc << 1) & 0xFF
        entries.append(crc)
    return bytes(entries)


_TABLE: Final = _table()
_TABLE_ARRAY: Final = np.frombuffer(_TABLE, dtype=np.uint8)

ALGORITHMS: Final = ("crc8_sae_j1850", "crc8_sae_j1850_id")  # the second begins with the id


def payload_checksums(
    algorithm: str, can_id: int, payloads: NDArray[np.uint8], checksum_byte: int
) -> NDArray[np.uint8]:
    """Return the checksum of each of ``payloads``, shape (..., n_bytes), as (...).

    algorithm : one of ALGORITHMS
    checksum_byte : place of the checksum in a payload, which does not count
    """
    starts = np.full(payloads.shape[:-1], _start(algorithm, can_id), dtype=np.uint8)
    each = np.moveaxis(payloads, -1, 0)
    return np.asarray(_through(_TABLE_ARRAY, starts, each, checksum_byte), dtype=np.uint8)


def payload_checksum(
    algorithm: str, can_id: int, data: bytes | bytearray, checksum_byte: int
) -> int:
    """Return the checksum of one payload, as ``payload_checksums``.

    Source: AUTOSAR Specification of CRC Routines, CRC8 SAE J1850; check value of "123456789".

    >>> hex(payload_checksum("crc8_sae_j1850", 0, b"123456789", checksum_byte=9))
    '0x4b'
    """
    return int(_through(_TABLE, _start(algorithm, can_id), data, checksum_byte))


def _start(algorithm: str, can_id: int) -> int:
    return _TABLE[INITIAL ^ (can_id & 0xFF)] if algorithm == "crc8_sae_j1850_id" else INITIAL


def _through(table: Any, crc: Any, payload: Iterable[Any], checksum_byte: int) -> Any:
    """Return the checksum of bytes: one number each, or one array each for many payloads."""
    for position, byte in enumerate(payload):
        if position != checksum_byte:
            crc = table[crc ^ byte]
    return crc ^ FINAL_XOR
