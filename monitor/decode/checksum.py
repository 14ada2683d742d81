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


_TABLE: Final = np.frombuffer(_table(), dtype=np.uint8)

ALGORITHMS: Final = ("crc8_sae_j1850", "crc8_sae_j1850_id")  # the second begins with the id


def payload_checksums(
    algorithm: str, can_id: int, payloads: NDArray[np.uint8], checksum_byte: int
) -> NDArray[np.uint8]:
    """Return the checksum of each row of ``payloads``, shape (n, n_bytes), as (n,).

    algorithm : one of ALGORITHMS
    checksum_byte : place of the checksum in a row, which does not count
    """
    begin = INITIAL ^ (can_id & 0xFF)
    start = _TABLE[begin] if algorithm == "crc8_sae_j1850_id" else INITIAL
    crc = np.full(len(payloads), start, dtype=np.uint8)
    for position in range(payloads.shape[1]):
        if position != checksum_byte:
            crc = _TABLE[crc ^ payloads[:, position]]
    return crc ^ np.uint8(FINAL_XOR)


def payload_checksum(
    algorithm: str, can_id: int, data: bytes | bytearray, checksum_byte: int
) -> int:
    """Return the checksum of one payload, as ``payload_checksums``.

    Source: AUTOSAR Specification of CRC Routines, CRC8 SAE J1850; check value of "123456789".

    >>> hex(payload_checksum("crc8_sae_j1850", 0, b"123456789", checksum_byte=9))
    '0x4b'
    """
    row = np.frombuffer(data, dtype=np.uint8)[np.newaxis]
    return int(payload_checksums(algorithm, can_id, row, checksum_byte)[0])
