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


def _table() -> NDArray[np.uint8]:
    crc = np.arange(256, dtype=np.uint8)
    for _ in range(8):
        crc = np.where(crc & 0x80, crc << 1 ^ POLYNOMIAL, crc << 1).astype(np.uint8)
    return crc


_TABLE: Final = _table()

ALGORITHMS: Final = ("crc8_sae_j1850", "crc8_sae_j1850_id")  # the second begins with the id


def payload_checksums(
    algorithm: str, can_id: int, payloads: NDArray[np.uint8], checksum_byte: int
) -> NDArray[np.uint8]:
    """Return the checksum of each of ``payloads``, shape (..., n_bytes), as (...).

    algorithm : one of ALGORITHMS
    checksum_byte : place of the checksum in a payload, which does not count
    """
    starts = _TABLE[INITIAL ^ (can_id & 0xFF)] if algorithm == ALGORITHMS[1] else INITIAL
    crc = np.full(payloads.shape[:-1], starts, dtype=np.uint8)
    for position, each in enumerate(np.moveaxis(payloads, -1, 0)):
        if position != checksum_byte:
            crc = _TABLE[crc ^ each]
    return np.asarray(crc ^ FINAL_XOR, dtype=np.uint8)


def payload_checksum(
    algorithm: str, can_id: int, data: bytes | bytearray, checksum_byte: int
) -> int:
    """Return the checksum of one payload, as ``payload_checksums``.

    Source: AUTOSAR Specification of CRC Routines, CRC8 SAE J1850; check value of "123456789".

    >>> hex(payload_checksum("crc8_sae_j1850", 0, b"123456789", checksum_byte=9))
    '0x4b'
    """
    payload = np.frombuffer(data, dtype=np.uint8)
    return int(payload_checksums(algorithm, can_id, payload, checksum_byte))
