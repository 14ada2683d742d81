"""Numbers from digits: eight characters at once in a 64-bit word, or two by a table of pairs.

Source: Lemire, Quickly parsing eight digits (2018).
"""

from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Chars = NDArray[np.uint8]
Words = NDArray[np.uint64]  # eight characters each, the first in the lowest byte

_EACH: Final = 0x0101010101010101  # this times a byte puts the byte into all eight places
_ZEROS: Final = np.uint64(0x30 * _EACH)
_FIRST: Final = np.array([(1 << 8 * n) - 1 for n in range(9)], dtype=np.uint64)
_PAIRS: Final = np.full(1 << 16, 1 << 15, dtype=np.uint16)  # of hexadecimal digits: their byte
for _first, _second in product(b"0123456789abcdefABCDEF", repeat=2):
    _PAIRS[_first | _second << 8] = int(bytes((_first, _second)), 16)


def gathered(text: Chars, offset: int, places: NDArray[np.int64], n_bytes: int) -> Chars:
    """Return ``n_bytes`` bytes from each of ``places + offset`` on, shape (n, n_bytes).

    >>> text = np.frombuffer(b"0123456789", dtype=np.uint8)
    >>> gathered(text, 1, np.array([2, 0]), 3).tobytes()
    b'345123'
    """
    n = len(text) - offset - n_bytes + 1
    steps = np.ndarray((n,), f"V{n_bytes}", buffer=text.data, offset=offset, strides=(1,))
    return steps[places].view(np.uint8).reshape(-1, n_bytes)


def first_bytes(words: Words, n: NDArray[np.integer[Any]]) -> Words:
    """Return words with 0 behind their first ``n`` bytes."""
    return words & _FIRST.take(n, mode="clip")


def zeroed(words: Words, n: NDArray[np.int64] | int) -> Words:
    """Return words with "0" in place of their first ``n`` characters.

    >>> zeroed(np.frombuffer(b"xxxx(123", dtype=np.uint64), 5).tobytes()
    b'00000123'
    """
    kept = words ^ _ZEROS
    kept &= ~_FIRST.take(n, mode="clip")
    kept ^= _ZEROS
    return kept


def decimal(words: Words) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the number of each word's eight decimal digits, and which words are all digits.

    >>> numbers, right = decimal(np.frombuffer(b"001234560012/456", dtype=np.uint64))
    >>> int(numbers[0]), right.tolist()
    (123456, [True, False])
    """
    digits = words ^ _ZEROS
    over = digits + np.uint64(0x06 * _EACH)
    over |= digits
    over &= np.uint64(0xF0 * _EACH)
    value = digits * np.uint64(10)  # pairs
    digits >>= np.uint64(8)
    value += digits
    value &= np.uint64(0x00FF00FF00FF00FF)
    pairs = value >> np.uint64(16)
    value *= np.uint64(100)
    value += pairs
    value &= np.uint64(0x0000FFFF0000FFFF)
    fours = value >> np.uint64(32)
    value *= np.uint64(10_000)
    value += fours
    value &= np.uint64(0xFFFFFFFF)
    return value.view(np.int64), over == 0


def hexadecimal(chars: Chars) -> tuple[Chars, Chars]:
    """Return the byte of each pair of digits in rows of them, and above 0 for pairs that are none.

    >>> values, wrong = hexadecimal(np.frombuffer(b"01aA0G", dtype=np.uint8).reshape(1, 6))
    >>> values.tolist(), wrong.tolist()
    ([[1, 170, 0]], [[0, 0, 128]])
    """
    pairs = _PAIRS.take(chars.view(np.uint16))
    return pairs.astype(np.uint8), (pairs >> 8).astype(np.uint8)
