"""Checksums of CAN payloads.

CRC8 SAE J1850: polynomial 0x1D, initial value 0xFF, not reflected, final XOR 0xFF. The project's
ECU protects each message over the low byte of its identifier, then all payload bytes but the
checksum's own, in their order; so a frame under a wrong identifier does not pass.
"""

from typing import Final

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


CRC8_TABLE: Final = _table()
_TABLE_ARRAY: Final = np.frombuffer(CRC8_TABLE, dtype=np.uint8)

ALGORITHMS: Final = ("crc8_sae_j1850", "crc8_sae_j1850_id")  # the second begins with the id


def crc8_sae_j1850(data: bytes) -> int:
    """Return the CRC8 SAE J1850 of ``data``, 0 to 255.

    Source: AUTOSAR Specification of CRC Routines, CRC8 SAE J1850; check value of "123456789".

    >>> hex(crc8_sae_j1850(b"123456789"))
    '0x4b'
    """
    crc = INITIAL
    for byte in data:
        crc = CRC8_TABLE[crc ^ byte]
    return crc ^ FINAL_XOR


def start_value(algorithm: str, can_id: int) -> int:
    """Return the CRC register before the first payload byte.

    algorithm : one of ALGORITHMS
    """
    return CRC8_TABLE[INITIAL ^ (can_id & 0xFF)] if algorithm == "crc8_sae_j1850_id" else INITIAL


def payload_checksum(
    algorithm: str, can_id: int, data: bytes | bytearray, checksum_byte: int
) -> int:
    """Return the checksum that belongs into byte ``checksum_byte`` of the payload ``data``.

    algorithm : one of ALGORITHMS
    """
    crc = start_value(algorithm, can_id)
    for position, byte in enumerate(data):
        if position != checksum_byte:
            crc = CRC8_TABLE[crc ^ byte]
    return crc ^ FINAL_XOR


def payload_checksums(
    algorithm: str, can_id: int, payloads: NDArray[np.uint8], checksum_byte: int
) -> NDArray[np.uint8]:
    """Return the checksum of each row of ``payloads``, shape (n, n_bytes), as (n,)."""
    crc = np.full(len(payloads), start_value(algorithm, can_id), dtype=np.uint8)
    for position in range(payloads.shape[1]):
        if position != checksum_byte:
            crc = _TABLE_ARRAY[crc ^ payloads[:, position]]
    return crc ^ np.uint8(FINAL_XOR)
