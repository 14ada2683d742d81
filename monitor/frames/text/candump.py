"""The log format of ``candump -L``: ``(1436509052.249713) vcan0 044#2A366C2BBA``.

It is parsed in chunks of thousands of lines. A plain line is one as candump, python-can and this
project write it; ``frame_of_line`` parses all other lines. Every step runs over all lines of a
chunk: it finds the marks (space, #, newline) once and gathers the digits around them.
"""

from collections.abc import Iterator
from typing import BinaryIO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray, Frame, FrameBlock, IntArray
from monitor.frames.blocks import EXTENDED, LogCounters, block_of, chosen, put, widened
from monitor.frames.channels import Channels
from monitor.frames.digits import decimal, first_bytes, gathered, hexadecimal, zeroed
from monitor.frames.text.layouts import frame_of_line
from monitor.frames.text.lines import CHUNK_BYTES, MARGIN, Bytes, line_chunks

Keys = NDArray[np.uint32]

WANTED: Final = "'(seconds) channel id#data' is wanted"
_ERROR_FLAG: Final = 0x20000000  # of an identifier
_SPACE, _HASH, _NEWLINE, _OPEN = b" #\n("
_LAST_MARK: Final = _HASH  # every other character of a plain line is higher
_SPARE: Final = 5  # marks added after the last line, for lines with too few marks
_CLASSIC: Final = [int.from_bytes(marks, "little") for marks in (b"  # ", b"  #\n")]
_FD: Final = int.from_bytes(b"  ##", "little")
_STAMP_ENDS: Final = np.uint64(int.from_bytes(b".\0\0\0\0\0\0)", "little"))
_STAMP_MARKS: Final = np.uint64(0xFF000000000000FF)
_LATEST_S: Final = 1 << 32  # up to this time a double rounds to the microsecond in the text


class Lines(NamedTuple):
    """The contents of the n lines of a chunk."""

    begin: IntArray  # (n + 1,) start of each line in the chunk, then the end of the last line
    plain: BoolArray  # (n,) True: the line is plain and parsed
    is_data: BoolArray  # (n,) True: a data frame
    frames: FrameBlock  # n rows
    name: IntArray  # (n,) begin of the channel's name
    name_end: IntArray  # (n,)


def read_blocks(
    file: BinaryIO,
    counters: LogCounters,
    channels: Channels | None = None,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[FrameBlock]:
    """Yield the data frames of candump text; error and remote frames are skipped and counted.

    Raises ValueError if too many lines have another format (``LogCounters.leave_out``),
    CutShortError if the last line has no end, and the errors of reading the file. The frames before
    the error are yielded first.
    """
    first, channels = 1, channels or Channels()
    for text in line_chunks(file, chunk_bytes):
        lines = parse_lines(text)
        rows, block, error = _understood(text, lines, first, counters)
        first += len(lines.plain)
        counters.frames += len(block.t_ns)
        if len(block.t_ns):
            yield channels.keep(block, *_names(text, lines, rows)) if channels.matter else block
        if error:
            raise error


def _names(text: Bytes, lines: Lines, rows: slice | BoolArray) -> tuple[list[str], IntArray | None]:
    """Return the names of the rows' channels, up to 8 characters, and the place of each row's."""
    begin, width = lines.name[rows], (lines.name_end - lines.name)[rows]
    words = gathered(text, MARGIN, begin, 8).view(np.uint64)[:, 0]
    words = first_bytes(words, width)
    unique, places = words[:1], None
    if (words != words[0]).any():
        unique, places = np.unique(words, return_inverse=True)
    names = [word.tobytes().rstrip(b"\0").decode(errors="replace") for word in unique]
    return names, places


def _understood(
    text: Bytes, lines: Lines, first: int, counters: LogCounters
) -> tuple[slice | BoolArray, FrameBlock, ValueError | None]:
    """Return rows and frames, and the error at which they end if too many lines are damaged.

    first : number in the file of the chunk's first line
    """
    if lines.is_data.all():
        return slice(None), lines.frames, None
    n, odd, error = len(lines.plain), dict[int, Frame](), None
    for row in np.flatnonzero(~lines.plain).tolist():
        raw = text[MARGIN + lines.begin[row] : MARGIN + lines.begin[row + 1]]
        line = raw.tobytes().decode(errors="surrogateescape").strip()
        if not line:
            continue
        try:
            frame = frame_of_line(line)
        except ValueError:
            try:
                counters.leave_out(first + row, line, WANTED)
                continue
            except ValueError as too_many:
                n, error = row, too_many
                break
        if frame is None:
            counters.skipped += 1
        else:
            odd[row] = frame
    is_data, block = lines.is_data[:n], chosen(lines.frames, slice(n))
    counters.skipped += int(np.count_nonzero(lines.plain[:n] & ~is_data))
    if odd:
        block = put(block, list(odd), block_of(list(odd.values())))
        is_data[list(odd)] = True
    rows = np.append(is_data, np.zeros(len(lines.plain) - n, dtype=np.bool_))
    return rows, chosen(block, is_data), error


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
    length, data, right = _payloads(text, sign + 1, end, 8)
    frames = FrameBlock(t_ns, key, length, data)
    pattern = gathered(codes, 0, mark, 4).view(np.uint32)[:, 0]
    right &= (pattern == _CLASSIC[0]) | (pattern == _CLASSIC[1])
    rows = np.flatnonzero(pattern == _FD)
    if len(rows):
        frames, right[rows] = _with_fd(text, marks, mark, rows, frames)
    plain &= right
    return Lines(begin, plain, plain & ~is_error, frames, space + 1, second)


def _with_fd(
    text: Bytes, marks: IntArray, mark: IntArray, rows: IntArray, frames: FrameBlock
) -> tuple[FrameBlock, BoolArray]:
    """Return the frames with the data of CAN FD lines, and which of these lines are plain.

    mark : (n,) index of each line's first mark
    rows : the CAN FD lines
    """
    first, second, end = (marks.take(mark[rows] + i) for i in (2, 3, 4))
    length, data, right = _payloads(text, first + 3, end, 64)  # after ## and the flag digit
    ending = text[MARGIN:].take(end)
    right &= (second == first + 1) & ((ending == _SPACE) | (ending == _NEWLINE))
    width = 8 if length.max(where=right, initial=0) <= 8 else 64
    (frames,) = widened(frames, least=width)
    frames.length[rows], frames.data[rows] = length, data[:, :width]
    return frames, right


def _times(text: Bytes, begin: IntArray, space: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the times in ns, and which lines write them as ``(1436509052.249713)``.

    begin, space : start and first space of each line
    """
    digits = space - begin - len("(.249713)")
    right = text[MARGIN:].take(begin) == _OPEN
    right &= (digits >= 1) & (digits <= 10)
    high, low, end = gathered(text, MARGIN - 24, space, 24).view(np.uint64).T
    right &= (end & _STAMP_MARKS) == _STAMP_ENDS
    micro, is_number = decimal(zeroed(end << np.uint64(8), 2))
    right &= is_number
    high, low = zeroed(high, 16 - digits), zeroed(low, 8 - digits)
    changed = np.ones(len(begin), dtype=np.bool_)  # the seconds change rarely
    np.not_equal(low[1:], low[:-1], out=changed[1:])
    changed[1:] |= high[1:] != high[:-1]
    rows = np.flatnonzero(changed)
    (upper, is_upper), (lower, is_lower) = decimal(high[rows]), decimal(low[rows])
    seconds = upper * 10**8 + lower
    n_lines = np.diff(rows, append=len(begin))
    right &= np.repeat(is_upper & is_lower & (seconds < _LATEST_S), n_lines)
    t_ns = np.repeat(seconds * 1_000_000, n_lines)
    t_ns += micro
    t_ns *= 1000
    return t_ns, right


def _keys(text: Bytes, second: IntArray, sign: IntArray) -> tuple[Keys, BoolArray, BoolArray]:
    """Return the keys, which mark error frames, and which have 3 or 8 hexadecimal digits.

    second, sign : second space and # of each line
    """
    digits = sign - second - 1
    is_extended = digits == 8
    right = is_extended | (digits == 3)
    words = gathered(text, MARGIN - 8, sign, 8).view(np.uint64)[:, 0]
    values, wrong = hexadecimal(zeroed(words, 8 - digits).view(np.uint8).reshape(-1, 8))
    right &= wrong.view(np.uint32)[:, 0] == 0
    key = values.view(">u4")[:, 0].astype(np.uint32)
    right &= key < np.where(is_extended, np.uint32(1 << 30), np.uint32(1 << 11))
    is_error = (key & _ERROR_FLAG) != 0
    key &= np.uint32(0x1FFFFFFF)
    key |= is_extended * np.uint32(EXTENDED)
    return key, is_error, right


def _payloads(
    text: Bytes, first: IntArray, end: IntArray, n_bytes: int
) -> tuple[Bytes, Bytes, BoolArray]:
    """Return lengths and data of up to ``n_bytes`` bytes, and which lines are valid.

    first, end : start and end of the hexadecimal digits
    """
    digits = end - first
    right = (digits >= 0) & (digits <= 2 * n_bytes) & (digits & 1 == 0)
    data, wrong = hexadecimal(gathered(text, MARGIN, first, 2 * n_bytes))
    for place in range(n_bytes // 8):
        for each in data, wrong:
            words = each.view(np.uint64)[:, place]
            words[:] = first_bytes(words, (digits >> 1) - 8 * place)
        right &= words == 0
    return (digits >> 1).astype(np.uint8), data, right
