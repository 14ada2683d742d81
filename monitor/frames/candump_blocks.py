"""The log format of ``candump -L``, parsed in chunks of thousands of lines.

The frames, counters and errors are those of ``monitor.frames.candump``. A plain line is one as
candump, python-can and this project write it; ``monitor.frames.candump`` parses all other lines.
Every step runs over all lines of a chunk: it finds the marks (space, #, newline) once and gathers
the text around them as words of eight characters.
"""

from collections.abc import Iterator
from io import BufferedIOBase
from typing import BinaryIO, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray, Frame, FrameBlock, IntArray
from monitor.frames import swar
from monitor.frames.blocks import EXTENDED, block_of, chosen, put, widened
from monitor.frames.candump import ERROR_FLAG, LogCounters, read_candump
from monitor.frames.text.lines import CHUNK_BYTES, MARGIN, Bytes, line_chunks

Keys = NDArray[np.uint32]

_SPACE, _HASH, _NEWLINE, _OPEN = b" #\n("
_LAST_MARK: Final = _HASH  # every other character of a plain line is higher
_SPARE: Final = 5  # marks added after the last line, for lines with too few marks
_CLASSIC: Final = [int.from_bytes(marks, "little") for marks in (b"  # ", b"  #\n")]
_FD: Final = int.from_bytes(b"  ##", "little")
_BYTE: Final = np.uint64(8)  # bits in a byte
_STAMP_ENDS: Final = np.uint64(int.from_bytes(b".\0\0\0\0\0\0)", "little"))
_STAMP_MARKS: Final = np.uint64(0xFF000000000000FF)
LATEST_S: Final = 1 << 32  # up to this time a double rounds to the microsecond in the text

# Masks of the characters of a word that belong to a field, by the field's length.
_SIX: Final = np.uint64(swar.kept_last(6))
_HIGH_SECONDS: Final = swar.masks([swar.kept_last(n - 8) for n in range(11)])
_LOW_SECONDS: Final = swar.masks([swar.kept_last(n) for n in range(11)])
_IDENTIFIER: Final = swar.masks([swar.kept_last(n) for n in range(9)])
_DATA: Final = [swar.masks([swar.kept_first(n - 8 * i) for n in range(129)]) for i in range(16)]


class Lines(NamedTuple):
    """The contents of the n lines of a chunk."""

    begin: IntArray  # (n + 1,) start of each line in the chunk, then the end of the last line
    plain: BoolArray  # (n,) True: the line is plain and parsed
    is_data: BoolArray  # (n,) True: a data frame
    frames: FrameBlock  # n rows


def read_blocks(
    file: BinaryIO,
    counters: LogCounters,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[FrameBlock]:
    """Yield the frames of candump text, the same as ``monitor.frames.candump.read_candump``.

    Raises ValueError if a line has another format (with its number) or the last line is cut
    short, and the errors of reading the file. The frames before the error are yielded first.
    """
    first = 1
    for text in line_chunks(cast(BufferedIOBase, file), chunk_bytes):
        lines = parse_lines(text)
        block, error = _understood(text, lines, first, counters)
        first += len(lines.plain)
        counters.frames += len(block.t_ns)
        if len(block.t_ns):
            yield block
        if error:
            raise error


def _understood(
    text: Bytes, lines: Lines, first: int, counters: LogCounters
) -> tuple[FrameBlock, ValueError | None]:
    """Return the frames up to the first line of another format, and that line's error.

    first : number in the file of the chunk's first line
    """
    if lines.is_data.all():
        return lines.frames, None
    rows, frames, n, error = _odd_frames(text, lines, first, counters)
    is_data, block = lines.is_data[:n], chosen(lines.frames, slice(n))
    counters.skipped += int(np.count_nonzero(lines.plain[:n] & ~is_data))
    if frames:
        block = put(block, rows, block_of(frames))
        is_data[rows] = True
    return chosen(block, is_data), error


def _odd_frames(
    text: Bytes, lines: Lines, first: int, counters: LogCounters
) -> tuple[list[int], list[Frame], int, ValueError | None]:
    """Parse the lines that are not plain one by one.

    Returns the rows that are frames, the frames, the number of rows before the first bad line, and
    that line's error.
    """
    row = 0

    def odd_lines() -> Iterator[tuple[int, str]]:
        nonlocal row
        for row in np.flatnonzero(~lines.plain).tolist():
            line = text[MARGIN + lines.begin[row] : MARGIN + lines.begin[row + 1]]
            yield first + row, line.tobytes().decode(errors="surrogateescape")

    rows: list[int] = []
    frames: list[Frame] = []
    odd = LogCounters()
    try:
        for frame in read_candump(odd_lines(), odd):
            rows.append(row)
            frames.append(frame)
    except ValueError as error:
        return rows, frames, row, error
    finally:
        counters.skipped += odd.skipped
    return rows, frames, len(lines.plain), None


def parse_lines(text: Bytes) -> Lines:
    """Parse the lines of ``text``; it has ``MARGIN`` bytes before and after them.

    The last line must end with a newline.
    """
    n_bytes = len(text) - 2 * MARGIN
    is_mark = np.ones(n_bytes + _SPARE, dtype=np.bool_)
    np.less_equal(text[MARGIN : MARGIN + n_bytes], _LAST_MARK, out=is_mark[:n_bytes])
    marks = np.flatnonzero(is_mark)
    codes = text[MARGIN:].take(marks)
    last = np.flatnonzero(codes[:-_SPARE] == _NEWLINE)  # index of each line's last mark
    begin = np.zeros(len(last) + 1, dtype=np.int64)
    np.add(marks.take(last), 1, out=begin[1:])
    mark = np.zeros_like(last)
    np.add(last[:-1], 1, out=mark[1:])
    space, second, sign, end = (marks.take(mark + i) for i in range(4))
    t_ns, plain = _times(text, begin[:-1], space)
    plain &= second > space + 1  # the channel has a name
    key, is_error, right = _keys(text, second, sign)
    plain &= right
    if _has_other_than_ascii(text):
        plain &= _is_ascii(text, begin)
    length, data, right = _payloads(text, sign + 1, end, 1)
    frames = FrameBlock(t_ns, key, length, data)
    pattern = swar.gathered(codes, 0, mark, 4).view(np.uint32)[:, 0]
    right &= (pattern == _CLASSIC[0]) | (pattern == _CLASSIC[1])
    rows = np.flatnonzero(pattern == _FD)
    if len(rows):
        frames, right[rows] = _with_fd(text, marks, mark, rows, frames)
    plain &= right
    return Lines(begin, plain, plain & ~is_error, frames)


def _with_fd(
    text: Bytes, marks: IntArray, mark: IntArray, rows: IntArray, frames: FrameBlock
) -> tuple[FrameBlock, BoolArray]:
    """Return the frames with the data of CAN FD lines, and which of these lines are plain.

    mark : (n,) index of each line's first mark
    rows : the CAN FD lines
    """
    first, second, end = (marks.take(mark[rows] + i) for i in (2, 3, 4))
    length, data, right = _payloads(text, first + 3, end, 8)  # after ## and the flag digit
    ending = text[MARGIN:].take(end)
    right &= (second == first + 1) & ((ending == _SPACE) | (ending == _NEWLINE))
    width = 8 if length.max(where=right, initial=0) <= 8 else 64
    frames = widened(frames, width)
    frames.length[rows], frames.data[rows] = length, data[:, :width]
    return frames, right


def _has_other_than_ascii(text: Bytes) -> bool:
    n = len(text) & ~7
    return bool(np.bitwise_or.reduce(text[:n].view(np.uint64)) & np.uint64(0x8080808080808080))


def _is_ascii(text: Bytes, begin: IntArray) -> BoolArray:
    """Return which lines are pure ASCII, shape (n,)."""
    others = np.flatnonzero(text[MARGIN:-MARGIN] >= 0x80)
    before = np.searchsorted(others, begin)
    return np.equal(before[1:], before[:-1])


def _times(text: Bytes, begin: IntArray, space: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the times in ns, and which lines write them as ``(1436509052.249713)``.

    begin, space : start and first space of each line
    """
    digits = space - begin - len("(.249713)")
    right = text[MARGIN:].take(begin) == _OPEN
    right &= (digits >= 1) & (digits <= 10)
    high, low, end = swar.gathered(text, MARGIN - 24, space, 24).view(np.uint64).T
    right &= (end & _STAMP_MARKS) == _STAMP_ENDS
    micro, is_number = swar.decimal(swar.only(end << _BYTE, _SIX))
    right &= is_number
    # the seconds change rarely, so only the changes are parsed
    high = high & _HIGH_SECONDS.take(digits, mode="clip")
    low = low & _LOW_SECONDS.take(digits, mode="clip")
    changed = np.ones(len(begin), dtype=np.bool_)
    np.not_equal(low[1:], low[:-1], out=changed[1:])
    changed[1:] |= high[1:] != high[:-1]
    rows = np.flatnonzero(changed)
    seconds, is_number = _seconds(high[rows], low[rows], digits[rows])
    n_lines = np.diff(rows, append=len(begin))
    if not is_number.all():
        right &= np.repeat(is_number, n_lines)
    t_ns = np.repeat(seconds * 1_000_000, n_lines)
    t_ns += micro
    t_ns *= 1000
    return t_ns, right


def _seconds(high: swar.Words, low: swar.Words, digits: IntArray) -> tuple[IntArray, BoolArray]:
    """Return numbers of up to ten digits, and which are valid."""
    upper, is_upper = swar.decimal(swar.only(high, _HIGH_SECONDS.take(digits, mode="clip")))
    lower, is_lower = swar.decimal(swar.only(low, _LOW_SECONDS.take(digits, mode="clip")))
    seconds = upper * 10**8 + lower
    return seconds, is_upper & is_lower & (seconds < LATEST_S)


def _keys(text: Bytes, second: IntArray, sign: IntArray) -> tuple[Keys, BoolArray, BoolArray]:
    """Return the keys, which mark error frames, and which have 3 or 8 hexadecimal digits.

    second, sign : second space and # of each line
    """
    digits = sign - second - 1
    is_extended = digits == 8
    right = is_extended | (digits == 3)
    first, rest = swar.gathered(text, MARGIN - 15, sign, 16).view(np.uint64).T
    words = rest << _BYTE
    words |= first >> np.uint64(56)
    value, is_number = swar.hexadecimal(swar.only(words, _IDENTIFIER.take(digits, mode="clip")))
    right &= is_number
    key = value.astype(np.uint32).byteswap()
    is_error = (key & ERROR_FLAG) != 0
    key &= np.uint32(0x1FFFFFFF)
    key |= is_extended * np.uint32(EXTENDED)
    return key, is_error, right


def _payloads(
    text: Bytes, first: IntArray, end: IntArray, n_words: int
) -> tuple[Bytes, Bytes, BoolArray]:
    """Return lengths and data of up to ``8 * n_words`` bytes, and which lines are valid.

    first, end : start and end of the hexadecimal digits
    """
    digits = end - first
    right = (digits >= 0) & (digits <= 16 * n_words) & (digits & 1 == 0)
    words = swar.gathered(text, MARGIN, first, 16 * n_words).view(np.uint64).T
    data = np.empty((len(first), n_words), dtype=np.uint64)
    for i in range(n_words):
        low, is_low = _masked(words[2 * i], _DATA[2 * i], digits)
        high, is_high = _masked(words[2 * i + 1], _DATA[2 * i + 1], digits)
        high <<= np.uint64(32)
        np.bitwise_or(low, high, out=data[:, i])
        right &= is_low
        right &= is_high
    return (digits >> 1).astype(np.uint8), data.view(np.uint8), right


def _masked(words: swar.Words, masks: swar.Words, digits: IntArray) -> tuple[swar.Words, BoolArray]:
    return swar.hexadecimal(swar.only(words, masks.take(digits, mode="clip")))
