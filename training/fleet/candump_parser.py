"""Compiled parser of candump text, a faster ``monitor.frames.candump_blocks.parse_lines``.

The parser reads every line once, eight characters at a time, as ``monitor.frames.swar`` does.
"""
# mypy: disable-error-code="no-untyped-def"

import numpy as np
from numba import njit

from monitor.base.types import FrameBlock
from monitor.frames import candump_blocks
from monitor.frames.candump import ERROR_FLAG
from monitor.frames.lines import MARGIN, Bytes

_EACH = np.uint64(0x0101010101010101)
_ZEROS = np.uint64(0x30) * _EACH
_SIX = np.uint64(0x06) * _EACH
_LOW_HALF, _HIGH_HALF = np.uint64(0x0F) * _EACH, np.uint64(0xF0) * _EACH
_TOP_BIT, _REST = np.uint64(0x80) * _EACH, np.uint64(0x7F) * _EACH
_LAST_THREE = np.uint64(0xFFFFFF0000000000)
_KEPT = np.array([(1 << 8 * n) - 1 for n in range(9)], dtype=np.uint64)  # mask of n first bytes
_LATEST_S = candump_blocks.LATEST_S
_PLAIN, _DATA, _FD = 1, 2, 4  # bits of a line's state: parsed, data frame, perhaps CAN FD


def parse_lines(text: Bytes) -> candump_blocks.Lines:
    """Return the lines of candump text; the result equals ``candump_blocks.parse_lines(text)``.

    Text with a CAN FD line goes to ``candump_blocks.parse_lines``.
    """
    n = int(np.count_nonzero(text[MARGIN:-MARGIN] == ord("\n")))
    begin = np.empty(n + 1, dtype=np.int64)
    state = np.empty(n, dtype=np.uint8)
    t_ns = np.empty(n, dtype=np.int64)
    key = np.empty(n, dtype=np.uint32)
    length = np.empty(n, dtype=np.uint8)
    data = np.empty(n, dtype=np.uint64)
    if _parse(text, MARGIN, len(text) - MARGIN, begin, state, t_ns, key, length, data):
        return candump_blocks.parse_lines(text)
    frames = FrameBlock(t_ns, key, length, data.view(np.uint8).reshape(n, 8))
    return candump_blocks.Lines(begin, (state & _PLAIN) != 0, (state & _DATA) != 0, frames)


@njit(inline="always")
def _word(text, at):  # pragma: no cover
    """Return the eight characters at ``at`` as one word; compiled, this is one load."""
    place = np.uint64(at)
    word = np.uint64(text[place])
    for i in range(1, 8):
        word |= np.uint64(text[place + np.uint64(i)]) << np.uint64(8 * i)
    return word


@njit(inline="always")
def _decimal(word):  # pragma: no cover
    """Return the number of eight decimal digits; set bits in the second value mark wrong digits."""
    value = word ^ _ZEROS
    wrong = (value | (value + _SIX)) & _HIGH_HALF
    value = (value * np.uint64(10) + (value >> np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
    value = (value * np.uint64(100) + (value >> np.uint64(16))) & np.uint64(0x0000FFFF0000FFFF)
    value = (value * np.uint64(10_000) + (value >> np.uint64(32))) & np.uint64(0xFFFFFFFF)
    return np.int64(value), wrong


@njit(inline="always")
def _hexadecimal(word):  # pragma: no cover
    """Return the four bytes of eight hexadecimal digits, and bits that mark wrong digits."""
    letter = (word >> np.uint64(6)) & _EACH
    nibbles = (word & _LOW_HALF) + letter * np.uint64(9)
    text = (((nibbles + _SIX) >> np.uint64(4)) & _EACH) * np.uint64(39) + nibbles + _ZEROS
    wrong = (text ^ (word | (letter << np.uint64(5)))) | (nibbles & _HIGH_HALF)
    found = ((nibbles << np.uint64(4)) | (nibbles >> np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
    found = (found | (found >> np.uint64(8))) & np.uint64(0x0000FFFF0000FFFF)
    found = (found | (found >> np.uint64(16))) & np.uint64(0xFFFFFFFF)
    return found, wrong


@njit(inline="always")
def _n_right(wrong):  # pragma: no cover
    """Return how many of the eight characters stand before the first wrong character."""
    tops = (((wrong & _REST) + _REST) | wrong) & _TOP_BIT
    lowest = tops & (~tops + np.uint64(1))
    before = ((lowest - np.uint64(1)) >> np.uint64(7)) & _EACH
    return np.int64((before * _EACH) >> np.uint64(56))


@njit(inline="always")
def _time(text, at):  # pragma: no cover
    """Return the time in µs, negative if malformed, and the position after it."""
    if text[at] != 40:  # (
        return -1, at
    n_digits = 10
    if text[at + 11] != 46:
        n_digits = 1
        while n_digits < 10 and text[at + 1 + n_digits] != 46:
            n_digits += 1
    dot = at + 1 + n_digits
    if text[dot] != 46 or text[dot + 7] != 41 or text[dot + 8] != 32:  # .249713)
        return -1, at
    micro, wrong = _decimal(
        ((_word(text, dot + 1) << np.uint64(16)) & ~np.uint64(0xFFFF)) | np.uint64(0x3030)
    )
    seconds, rest = np.int64(0), at + 1
    if n_digits == 10:
        seconds, wrong_start = _decimal(_word(text, rest))
        wrong |= wrong_start
        rest += 8
    for i in range(rest, dot):
        wrong |= np.uint64(text[i] < 48 or text[i] > 57)
        seconds = seconds * 10 + (np.int64(text[i]) - 48)
    if wrong != 0 or seconds >= _LATEST_S:
        return -1, at
    return seconds * 1_000_000 + micro, dot + 9


@njit(inline="always")
def _identifier(text, at):  # pragma: no cover
    """Return the identifier before the # and its number of digits: 3, 8, or 0 if malformed."""
    if text[at + 3] == 35:
        word = (_word(text, at - 5) & _LAST_THREE) | (_ZEROS & ~_LAST_THREE)
        n_digits = 3
    else:
        word = _word(text, at)
        n_digits = 8
    found, wrong = _hexadecimal(word)
    if wrong != 0 or text[at + n_digits] != 35:
        n_digits = 0
    number = ((found & np.uint64(0xFF)) << np.uint64(24)) | (found >> np.uint64(24))
    number |= (found & np.uint64(0xFF00)) << np.uint64(8)
    number |= (found >> np.uint64(8)) & np.uint64(0xFF00)
    return np.int64(number), n_digits


@njit(cache=True, error_model="numpy")
def _parse(text, first, end, begin, state, t_ns, key, length, data):  # pragma: no cover
    """Parse the lines from ``first`` to ``end`` into the arrays; return True at a CAN FD line."""
    at = first
    for row in range(len(state)):
        begin[row] = at - first
        found = 0
        time_us, at = _time(text, at)
        if time_us >= 0:
            channel = at
            while 35 < text[at] < 128:
                at += 1
            number, n_digits = _identifier(text, at + 1)
            if text[at] == 32 and at > channel and n_digits > 0:
                at += n_digits + 2
                if text[at] == 35:
                    return True
                low, wrong = _hexadecimal(_word(text, at))
                n = _n_right(wrong)
                high, wrong = _hexadecimal(_word(text, at + 8))
                if n == 8:
                    n += _n_right(wrong)
                is_end = text[at + n] == 10 or text[at + n] == 32
                if is_end and n & 1 == 0:
                    found = _PLAIN if number & ERROR_FLAG else _PLAIN | _DATA
                    extended = 0x80000000 if n_digits == 8 else 0
                    t_ns[row] = time_us * 1000
                    key[row] = (number & 0x1FFFFFFF) | extended
                    length[row] = n >> 1
                    data[row] = (low | (high << np.uint64(32))) & _KEPT[n >> 1]
                    at += n
        while text[at] != 10:  # skip a comment or the rest of a malformed line
            at += 1
        at += 1
        state[row] = found
    begin[len(state)] = end - first
    return False
