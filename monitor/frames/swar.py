"""Numbers from text, eight characters at once in a 64-bit word (SIMD within a register).

A word holds eight ASCII characters, the first in its lowest byte. Sources: Lamport,
Multiple byte processing with full-word instructions, CACM 18 (1975); Lemire, Quickly parsing eight
digits (2018).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]

_EACH: Final = 0x0101010101010101  # this times a byte puts the byte into all eight places
ZEROS: Final = np.uint64(0x30 * _EACH)


def kept_last(n: int) -> int:
    """Return the mask of a word's last ``n`` characters.

    >>> f"{kept_last(2):016x}"
    'ffff000000000000'
    """
    n = min(max(n, 0), 8)
    return (1 << 64) - (1 << 8 * (8 - n))


def kept_first(n: int) -> int:
    """Return the mask of a word's first ``n`` characters.

    >>> f"{kept_first(2):016x}"
    '000000000000ffff'
    """
    return (1 << 8 * min(max(n, 0), 8)) - 1


def masks(numbers: list[int]) -> Words:
    """Return masks as a lookup table."""
    return np.array(numbers, dtype=np.uint64)


def gathered(
    text: NDArray[np.uint8], offset: int, places: NDArray[np.int64], n_bytes: int
) -> NDArray[np.uint8]:
    """Return ``n_bytes`` bytes from each of ``places + offset`` on, shape (n, n_bytes).

    >>> text = np.frombuffer(b"0123456789", dtype=np.uint8)
    >>> gathered(text, 1, np.array([2, 0]), 3).tobytes()
    b'345123'
    """
    n = len(text) - offset - n_bytes + 1
    steps = np.ndarray((n,), f"V{n_bytes}", buffer=text.data, offset=offset, strides=(1,))
    return steps[places].view(np.uint8).reshape(-1, n_bytes)


def only(words: Words, mask: Words | np.uint64) -> Words:
    """Return the characters under ``mask``, and "0" in all other places."""
    kept = words ^ ZEROS
    kept &= mask
    kept ^= ZEROS
    return kept


def decimal(words: Words) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the number of each word's eight decimal digits, and which words are all digits.

    >>> numbers, right = decimal(np.frombuffer(b"001234560012/456", dtype=np.uint64))
    >>> int(numbers[0]), right.tolist()
    (123456, [True, False])
    """
    digits = words ^ ZEROS
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


def hexadecimal(words: Words) -> tuple[Words, NDArray[np.bool_]]:
    """Return the four bytes of each word's eight hexadecimal digits, and which words are valid.

    The first byte is the lowest of the result.

    >>> values, right = hexadecimal(np.frombuffer(b"0102aAff0000000G", dtype=np.uint64))
    >>> hex(values[0]), right.tolist()
    ('0xffaa0201', [True, False])
    """
    letter = words >> np.uint64(6)
    letter &= np.uint64(_EACH)
    nibbles = words & np.uint64(0x0F * _EACH)
    wrong = letter * np.uint64(9)
    nibbles += wrong
    # check: writing the nibbles as lower-case digits must give the text in lower case
    np.add(nibbles, np.uint64(0x06 * _EACH), out=wrong)
    wrong >>= np.uint64(4)
    wrong &= np.uint64(_EACH)
    wrong *= np.uint64(ord("a") - ord("0") - 10)
    wrong += nibbles
    wrong += ZEROS
    letter <<= np.uint64(5)
    letter |= words
    wrong ^= letter
    wrong |= np.bitwise_and(nibbles, np.uint64(0xF0 * _EACH), out=letter)
    value = np.left_shift(nibbles, np.uint64(4), out=letter)
    nibbles >>= np.uint64(8)
    value |= nibbles
    value &= np.uint64(0x00FF00FF00FF00FF)
    value |= np.right_shift(value, np.uint64(8), out=nibbles)
    value &= np.uint64(0x0000FFFF0000FFFF)
    value |= np.right_shift(value, np.uint64(16), out=nibbles)
    value &= np.uint64(0xFFFFFFFF)
    return value, wrong == 0
