"""Lines of candump at once, by numpy: those read one by one; written as python-can writes."""

import gzip
import io
import zlib
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.types import Frame, FrameBlock
from monitor.bus.link.recorder import message_of
from monitor.frames.blocks import LogCounters, block_of
from monitor.frames.bounds import open_binary
from monitor.frames.logs import guarded
from monitor.frames.text import candump, layouts
from monitor.frames.text.candump_lines import lines_of
from monitor.frames.text.lines import MARGIN
from tests.helpers.examples import inputs
from tests.helpers.logs.read_outcome import Outcome, frames_of, frames_of_line, outcome, streamed


def in_chunks(path: Path, chunk_bytes: int) -> Outcome:
    counters = LogCounters()

    def blocks() -> Iterator[FrameBlock]:
        with open_binary(path) as file:
            yield from candump.read_blocks(file, counters, chunk_bytes=chunk_bytes)

    found = guarded(path, counters, blocks())
    return outcome((frame for block in found for frame in frames_of(block)), counters)


HEX = "0123456789ABCDEFabcdef"
STAMP = st.one_of(
    st.integers(0, 2**32 * 10**6 - 1).map(lambda us: f"({us // 10**6}.{us % 10**6:06d})"),
    st.sampled_from(["(1700000000.123456)", "(1700000001.999999)", "(0.000001)", "(12.500000)"]),
    st.floats(0, 5e9).map(lambda t: f"({t:f})"),
    st.integers(0, 10**20).map(lambda ns: f"({ns // 10**9}.{ns % 10**9:09d})"),
    st.text("0123456789.()e-+_ ", max_size=20),
    st.sampled_from(["(1e300)", "(nan)", "(inf)", "(-1.000000)", "(9200000000.000000)", "(.5)"]),
)
CHANNEL = st.one_of(
    st.sampled_from(
        ["can0", "vcan12", "x", "a_very_long_channel_name_0", "kanal\u00a00", "\u00e4"]
    ),
    st.text('can0#!"\u2003', min_size=1, max_size=5),
)
IDENTIFIER = st.one_of(
    st.integers(0, 0xFFF).map("{:03X}".format),
    st.integers(0, 0xFFFFFFFF).map("{:08X}".format),
    st.integers(0, 0x1FFFFFFF).map("{:08x}".format),
    st.text(HEX + "x_+- G", max_size=9),
)
DATA = st.one_of(
    st.binary(max_size=8).map(lambda data: data.hex().upper()),
    st.binary(max_size=66).map(lambda data: "#1" + data.hex()),
    st.text(HEX, max_size=18),
    st.text(HEX + "GOg@`/:#RrT_ \u0660", max_size=20),
    st.sampled_from(["R", "r4", "R8", "##", "#", "#0", "###", "#1AB#", ""]),
)
TAIL = st.sampled_from(["", " R", " T", " ", "\t", " a b # c", "\u00a0R", "\x1f", "  "])
PLAIN = st.builds(
    lambda us, can_id, data: f"({us // 10**6}.{us % 10**6:06d}) can0 {can_id}#{data.hex().upper()}",
    st.integers(10**15, 2 * 10**15),
    st.one_of(
        st.integers(0, 0x7FF).map("{:03X}".format), st.integers(0, 2**29).map("{:08X}".format)
    ),
    st.binary(max_size=8),
)
LINE = st.one_of(
    PLAIN,
    PLAIN,
    st.builds("{} {} {}#{}{}".format, STAMP, CHANNEL, IDENTIFIER, DATA, TAIL),
    st.sampled_from(["", " ", "\t", "(1.0) can0", "hello world again", "\x00", "\x0b", "\x85"]),
)
END = st.sampled_from(["\n"] * 6 + ["\r\n", "\r", "\n\n"])


@st.composite
def texts(draw: st.DrawFn) -> bytes:
    """Draw candump text, mostly as it should be, sometimes spoilt."""
    lines = draw(st.lists(st.tuples(st.one_of(PLAIN, LINE), END), max_size=30))
    text = bytearray("".join(line + end for line, end in lines).encode())
    if text and draw(st.booleans()):
        for _ in range(draw(st.integers(1, 2))):
            text[draw(st.integers(0, len(text) - 1))] = draw(st.integers(0, 255))
    if draw(st.integers(0, 5)) == 0:
        del text[draw(st.integers(0, len(text))) :]
    return bytes(text)


@inputs(150)
@given(text=texts(), chunk_bytes=st.sampled_from([1, 7, 64, 333, 1 << 16]))
def test_candump_in_chunks_gives_frames_counters_and_errors_of_the_streaming_reader(
    tmp_path_factory: pytest.TempPathFactory, text: bytes, chunk_bytes: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.log"
    path.write_bytes(text or b"\n")
    wanted = streamed(path)
    assert in_chunks(path, chunk_bytes) == wanted


FORMS = [
    b"(1700000001.123456) can0 1A2#0123456789abCDeF",
    b"(1700000001.123456) can0 18FEF100#00fF R",
    b"(4294967295.999999) vcan0 123#",
    b"(12.345678) c 7FF##1AABBCC",
    b"(0.000001) can1 20000080#0000000000000000",
]


def parsed(lines: list[bytes]) -> candump.Lines:
    margin = b"\x0a" * MARGIN
    return candump.parse_lines(
        np.frombuffer(margin + b"\n".join(lines) + b"\n" + margin, dtype=np.uint8)
    )


def assert_as_streamed(lines: list[bytes], found: candump.Lines) -> None:
    """Hold each line that was understood to the streaming reader."""
    frames = frames_of(found.frames) if found.is_data.all() else None
    for row in np.flatnonzero(found.plain).tolist():
        counters = LogCounters()
        text = lines[row].decode(errors="surrogateescape")
        wanted = list(frames_of_line(1, text, counters))
        block = FrameBlock(*(column[row : row + 1] for column in found.frames))
        got = frames_of(block) if found.is_data[row] else []
        assert got == wanted, text
        assert counters.skipped == (not found.is_data[row])
    assert frames is None or len(frames) == len(lines)


@pytest.mark.parametrize("form", FORMS)
def test_a_line_with_any_one_byte_changed_is_read_rightly_or_left(form: bytes) -> None:
    lines = [
        form[:place] + bytes([byte]) + form[place + 1 :]
        for place in range(len(form))
        for byte in range(256)
        if byte not in b"\r\n"
    ]
    n_plain = 0
    for is_fd in (False, True):  # CAN FD changes how a chunk is parsed
        chunk = [line for line in lines if (b"##" in line) == is_fd]
        if chunk:
            found = parsed(chunk)
            assert len(found.plain) == len(chunk)
            assert_as_streamed(chunk, found)
            assert found.plain[[line == form for line in chunk]].all()
            n_plain += int(found.plain.sum())
    assert n_plain > 10 * len(form)  # digits change, and letters of the channel


def test_a_mark_too_few_or_too_many_is_left_to_the_streaming_reader() -> None:
    marked = [b"##1", b"#1#", b"# 00", b"#00#", b"#00 #", b"##", b"###", b"#", b" #", b""]
    lines = [b"(1.000000) can0 123" + end for end in marked]
    lines += [b"", b" ", b"(1.000000)", b"(1.000000) can0", b"(1.000000) can0 ", b"#", b"  #"]
    lines += [b"(1.000000)  123#", b"(12", b"345678.123456) can0 123#", b"x" * 300]
    for chunk in ([line for line in lines if b"##" not in line], lines):
        found = parsed([*chunk, FORMS[0]])
        assert_as_streamed([*chunk, FORMS[0]], found)
        assert found.plain[-1]  # what comes after is read
        assert len(found.plain) == len(chunk) + 1


@inputs(100)
@given(text=texts(), cut=st.integers(1, 40), flipped=st.integers(0, 200), bit=st.integers(0, 7))
def test_damaged_gzip_gives_the_frames_before_and_the_error_of_the_streaming_reader(
    tmp_path_factory: pytest.TempPathFactory, text: bytes, cut: int, flipped: int, bit: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.log.gz"
    whole = bytearray(gzip.compress(text * 7))
    if flipped < len(whole):
        whole[flipped] ^= 1 << bit
    for kept in (whole, whole[:-cut]):
        path.write_bytes(kept or b"\0")
        assert in_chunks(path, 200) == streamed(path)


def test_gzip_with_a_damaged_block_gives_the_frames_that_were_unpacked_before(
    tmp_path: Path,
) -> None:
    # GIVEN lines that pack well, and behind them a block of a type that does not exist
    lines = b"".join(b"(1.%06d) can0 123#0000\n" % i for i in range(3_000))
    packer = zlib.compressobj(wbits=31)
    path = tmp_path / "block.log.gz"
    path.write_bytes(packer.compress(lines) + packer.flush(zlib.Z_FULL_FLUSH) + b"\x07" * 20)
    found = in_chunks(path, 1 << 20)
    assert "invalid block type" in str(found[2])
    assert found == streamed(path)
    assert len(found[0]) > 1_000


US = 1000
data = st.one_of(st.binary(max_size=8), st.sampled_from([12, 16, 64]).map(bytes))
times = st.one_of(st.integers(0, 10**10), st.integers(0, 1_800_000_000_000_000))
frames = st.one_of(
    st.builds(Frame, times.map(lambda t: t * US), st.integers(0, 0x7FF), st.just(False), data),
    st.builds(Frame, times.map(lambda t: t * US), st.integers(0, 2**29 - 1), st.just(True), data),
)


@inputs(200)
@given(st.lists(frames, min_size=1, max_size=20))
def test_a_block_has_the_lines_that_python_can_writes(sent: list[Frame]) -> None:
    text = io.StringIO()
    writer = can.CanutilsLogWriter(text)
    writer.last_timestamp = 0.0  # of earlier frames: times that step back stay as they are
    for frame in sent:
        writer.on_message_received(message_of(frame))
    assert lines_of(block_of(sent)).decode() == text.getvalue()


@inputs(100)
@given(st.lists(frames, max_size=20), st.integers(-(10**12), 10**12))
def test_a_block_is_read_as_it_was_written_at_any_time(sent: list[Frame], shift_us: int) -> None:
    moved = [frame._replace(t_ns=frame.t_ns + shift_us * US) for frame in sent]
    lines = lines_of(block_of(moved)).decode().splitlines()
    assert list(map(layouts.frame_of_line, lines)) == moved
