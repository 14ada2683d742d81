import gzip
import re
import struct
import tracemalloc
import zlib
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import can
import numpy as np
import pytest
from can.util import dlc2len
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import dbc
from monitor.batch import blf, candump
from monitor.batch.blocks import EXTENDED
from monitor.batch.lines import MARGIN
from monitor.batch.read import read_blocks
from monitor.blf import check as check_blf
from monitor.bus_map import load_pairs
from monitor.candump import LATEST_S, LogCounters, read_candump
from monitor.errors import RecordingError
from monitor.sources import frame_of, guarded, open_binary, read_frames
from monitor.types import Frame, FrameBlock
from training.canlog import FrameBlock as SentFrames
from training.canlog import broadcast, write_log
from training.fleet import parse

ROOT = Path(__file__).resolve().parent.parent

Outcome = tuple[list[Frame], LogCounters, str | None]


def frames_of(block: FrameBlock) -> list[Frame]:
    assert (block.t_ns.dtype, block.key.dtype) == (np.int64, np.uint32)
    assert (block.length.dtype, block.data.dtype) == (np.uint8, np.uint8)
    assert block.data.shape in {(len(block.t_ns), 8), (len(block.t_ns), 64)}
    assert block.data.flags.c_contiguous
    behind = np.arange(block.data.shape[1]) >= block.length[:, np.newaxis]
    assert not block.data[behind].any()
    return [
        Frame(t_ns, key & (EXTENDED - 1), bool(key & EXTENDED), data[:length])
        for t_ns, key, length, data in zip(
            block.t_ns.tolist(), block.key.tolist(), block.length.tolist(),
            map(bytes, block.data), strict=True,
        )
    ]  # fmt: skip


def outcome(frames: Iterable[Frame], counters: LogCounters) -> Outcome:
    found: list[Frame] = []
    try:
        found.extend(frames)
    except RecordingError as error:
        return found, counters, str(error)
    return found, counters, None


def streamed(path: Path) -> Outcome:
    counters = LogCounters()
    return outcome(read_frames(path, counters), counters)


def in_chunks(path: Path, chunk_bytes: int, parse: candump.Parser | None = None) -> Outcome:
    counters = LogCounters()

    def blocks() -> Iterator[FrameBlock]:
        with open_binary(path) as file:
            yield from candump.read_blocks(file, counters, parse, chunk_bytes)

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


@settings(max_examples=150)
@given(text=texts(), chunk_bytes=st.sampled_from([1, 7, 64, 333, 1 << 16]))
def test_candump_in_chunks_gives_frames_counters_and_errors_of_the_streaming_reader(
    tmp_path_factory: pytest.TempPathFactory, text: bytes, chunk_bytes: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.log"
    path.write_bytes(text or b"\n")
    wanted = streamed(path)
    assert in_chunks(path, chunk_bytes) == wanted
    assert in_chunks(path, chunk_bytes, parse.parse_lines) == wanted


PARSERS = pytest.mark.parametrize("parser", [candump.parse_lines, parse.parse_lines])
FORMS = [
    b"(1700000001.123456) can0 1A2#0123456789abCDeF",
    b"(1700000001.123456) can0 18FEF100#00fF R",
    b"(4294967295.999999) vcan0 123#",
    b"(12.345678) c 7FF##1AABBCC",
    b"(0.000001) can1 20000080#0000000000000000",
]


def parsed(lines: list[bytes], parser: candump.Parser) -> candump.Lines:
    margin = b"\x0a" * MARGIN
    return parser(np.frombuffer(margin + b"\n".join(lines) + b"\n" + margin, dtype=np.uint8))


def assert_as_streamed(lines: list[bytes], found: candump.Lines) -> None:
    """Hold each line that was understood to the streaming reader."""
    frames = frames_of(found.frames) if found.is_data.all() else None
    for row in np.flatnonzero(found.plain).tolist():
        counters = LogCounters()
        text = lines[row].decode(errors="surrogateescape")
        wanted = list(read_candump([(1, text)], counters))
        block = FrameBlock(*(column[row : row + 1] for column in found.frames))
        got = frames_of(block) if found.is_data[row] else []
        assert got == wanted, text
        assert counters.skipped == (not found.is_data[row])
    assert frames is None or len(frames) == len(lines)


@PARSERS
@pytest.mark.parametrize("form", FORMS)
def test_a_line_with_any_one_byte_changed_is_read_rightly_or_left_to_the_streaming_reader(
    parser: candump.Parser, form: bytes
) -> None:
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
            found = parsed(chunk, parser)
            assert len(found.plain) == len(chunk)
            assert_as_streamed(chunk, found)
            assert found.plain[[line == form for line in chunk]].all()
            n_plain += int(found.plain.sum())
    assert n_plain > 10 * len(form)  # digits change, and letters of the channel


@PARSERS
def test_times_are_rounded_as_the_streaming_reader_rounds_them(parser: candump.Parser) -> None:
    rng = np.random.default_rng(5)
    times_us = [
        *rng.integers(0, 2**32 * 10**6, 3000).tolist(),
        *rng.integers(2**32 * 10**6, 9_199_999_999_999_999, 3000).tolist(),
        *(10**k - 1 for k in range(1, 16)),
    ]
    lines = [f"({t // 10**6}.{t % 10**6:06d}) can0 123#".encode() for t in times_us]
    found = parsed(lines, parser)
    assert_as_streamed(lines, found)
    assert found.plain[:3000].all()


@PARSERS
def test_a_mark_too_few_or_too_many_is_left_to_the_streaming_reader(
    parser: candump.Parser,
) -> None:
    marked = [b"##1", b"#1#", b"# 00", b"#00#", b"#00 #", b"##", b"###", b"#", b" #", b""]
    lines = [b"(1.000000) can0 123" + end for end in marked]
    lines += [b"", b" ", b"(1.000000)", b"(1.000000) can0", b"(1.000000) can0 ", b"#", b"  #"]
    lines += [b"(1.000000)  123#", b"(12", b"345678.123456) can0 123#", b"x" * 300]
    for chunk in ([line for line in lines if b"##" not in line], lines):
        found = parsed([*chunk, FORMS[0]], parser)
        assert_as_streamed([*chunk, FORMS[0]], found)
        assert found.plain[-1]  # what comes after is read
        assert len(found.plain) == len(chunk) + 1


@settings(max_examples=100)
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


def python_can_reads(path: Path) -> Outcome:
    """Read a BLF with python-can's reader, behind the check that it is whole."""
    counters = LogCounters()

    def frames() -> Iterator[Frame]:
        with path.open("rb") as file:
            check_blf(file)
        with can.BLFReader(path) as reader:
            for message in reader:
                if message.is_error_frame or message.is_remote_frame:
                    counters.skipped += 1
                    continue
                dlc, n = message.dlc, len(message.data)
                if dlc != n:
                    raise ValueError(f"a frame of {dlc} bytes holds only {n}")
                if not -LATEST_S < message.timestamp < LATEST_S:
                    raise ValueError(f"a frame at {message.timestamp:g} s")
                frame = frame_of(message)
                counters.frames += 1
                yield frame

    return outcome(guarded(path, counters, frames()), counters)


@pytest.mark.parametrize("byte", range(100, 40_000, 3_700))
def test_gzip_damaged_far_from_its_beginning_gives_the_same_frames(
    tmp_path: Path, byte: int
) -> None:
    path = tmp_path / "long.log.gz"
    write_log(path, synthetic(3_000))
    whole = bytearray(path.read_bytes())
    assert len(whole) > 40_000
    whole[byte] ^= 0x55
    path.write_bytes(whole)
    assert in_chunks(path, 30_000) == streamed(path)


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


def read_at_once(path: Path) -> Outcome:
    counters = LogCounters()
    blocks = read_blocks(path, counters)
    return outcome((frame for block in blocks for frame in frames_of(block)), counters)


def by_python_can(path: Path) -> list[Frame]:
    """Return the data frames that python-can's reader of the format finds."""
    with can.LogReader(path) as reader:
        return [frame_of(m) for m in reader if not (m.is_error_frame or m.is_remote_frame)]


SUFFIXES = [".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".csv", ".csv.gz", ".trc", ".mf4"]
START_NS = 1_700_000_000_123_456_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    ecu = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])
    t_ns = START_NS + np.arange(50) * 100_000_000
    drive = broadcast(ecu, t_ns, {"lambda_measured": np.linspace(0.8, 1.2, 50)})
    folder = tmp_path_factory.mktemp("logs")
    for suffix in SUFFIXES:
        write_log(folder / f"drive{suffix}", drive)
    return folder


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_gives_the_same_frames_at_once_and_one_by_one(
    folder: Path, suffix: str
) -> None:
    found = read_at_once(folder / f"drive{suffix}")
    assert found == streamed(folder / f"drive{suffix}")
    assert found[0] == by_python_can(folder / f"drive{suffix}")
    assert found[2] is None


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_cut_short_gives_the_same_frames_and_error(
    folder: Path, tmp_path: Path, suffix: str
) -> None:
    whole = (folder / f"drive{suffix}").read_bytes()
    path = tmp_path / f"cut{suffix}"
    for cut in np.random.default_rng(3).integers(1, len(whole), 12).tolist():
        path.write_bytes(whole[:cut])
        found = read_at_once(path)
        assert found == streamed(path)
        if suffix == ".blf":
            assert found == python_can_reads(path)


MESSAGE = st.builds(
    can.Message,
    timestamp=st.integers(0, 10**9).map(lambda us: 1.7e9 + us / 1e6),
    arbitration_id=st.integers(0, 0x7FF),
    is_extended_id=st.just(False),
    data=st.binary(max_size=8),
    channel=st.integers(0, 1),
    is_rx=st.booleans(),
)
EXTENDED_ID = st.builds(
    can.Message,
    timestamp=st.just(1.7e9 + 5),
    arbitration_id=st.integers(0, 2**29 - 1),
    data=st.binary(max_size=8),
    channel=st.just(0),
)
NO_DATA = st.builds(
    can.Message,
    timestamp=st.just(1.7e9 + 6),
    arbitration_id=st.integers(0, 0x7FF),
    is_extended_id=st.just(False),
    is_error_frame=st.booleans(),
    is_remote_frame=st.booleans(),
    channel=st.just(0),
).filter(lambda m: m.is_error_frame != m.is_remote_frame)
FD = st.builds(
    lambda data, can_id: can.Message(
        timestamp=1.7e9 + 7, arbitration_id=can_id, data=data, is_fd=True, channel=0
    ),
    st.sampled_from([*range(9), 12, 16, 20, 24, 32, 48, 64]).flatmap(
        lambda n: st.binary(min_size=n, max_size=n)
    ),
    st.integers(0, 2**29 - 1),
)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc", ".mf4"])
@settings(max_examples=15)
@given(data=st.data())
def test_logs_written_by_python_can_are_read_as_python_can_reads_them(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, data: st.DataObject
) -> None:
    kinds = [MESSAGE, EXTENDED_ID]
    kinds += [NO_DATA] if suffix != ".trc" else []
    kinds += [FD] if suffix in {".log", ".blf"} else []
    messages = data.draw(st.lists(st.one_of(*kinds), min_size=1, max_size=12))
    path = tmp_path_factory.getbasetemp() / f"written{suffix}"
    with can.Logger(path) as logger:
        for message in messages:
            logger.on_message_received(message)
    found = read_at_once(path)
    assert found == streamed(path)
    assert sorted(found[0]) == sorted(by_python_can(path))  # MF4: in the order of time
    assert len(found[0]) == sum(not (m.is_error_frame or m.is_remote_frame) for m in messages)
    assert found[1].skipped == len(messages) - len(found[0])


@pytest.mark.parametrize(
    "name", ["healthy_micro_trips_v102_s102.blf", "signal_missing_micro_trips_v118_s129.blf"]
)
def test_the_replay_logs_are_read_as_python_can_reads_them(name: str) -> None:
    path = ROOT / "replay_logs" / name
    found, _, error = read_at_once(path)
    assert error is None
    assert found == by_python_can(path)


def test_a_gzipped_blf_is_read_as_the_plain_one(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "drive.blf.gz"
    path.write_bytes(gzip.compress((folder / "drive.blf").read_bytes()))
    assert read_at_once(path)[:2] == read_at_once(folder / "drive.blf")[:2]
    assert read_at_once(path) == streamed(path)
    path.write_bytes(path.read_bytes()[:-9])
    found = read_at_once(path)
    assert found == streamed(path)
    assert found[0] == []  # a whole structure is wanted first
    assert "end-of-stream" in str(found[2])


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".blf"])
def test_memory_stays_flat_with_the_length_of_a_log(tmp_path: Path, suffix: str) -> None:
    peaks = []
    for n in (60_000, 240_000):
        path = tmp_path / f"long{n}{suffix}"
        write_log(path, synthetic(n))
        tracemalloc.start()
        assert sum(len(block.t_ns) for block in read_blocks(path)) == n
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def synthetic(n: int) -> SentFrames:
    rng = np.random.default_rng(n)
    return SentFrames(
        START_NS + np.arange(n) * 250_000,
        rng.integers(0, 0x7FF, n),
        np.zeros(n, dtype=np.bool_),
        np.full(n, 8),
        rng.integers(0, 256, (n, 8)).astype(np.uint8),
    )


@pytest.mark.parametrize(
    ("announced", "error"), [(2, None), (3, None), (4, "its header announces 4 objects")]
)
def test_a_blf_must_hold_as_many_objects_as_announced_whatever_they_are(
    tmp_path: Path, announced: int, error: str | None
) -> None:
    path = tmp_path / "marked.blf"
    with can.BLFWriter(path) as writer:
        writer.on_message_received(can.Message(timestamp=1.7e9, arbitration_id=1, data=b"\1"))
        writer.log_event("a marker is an object", 1.7e9)
        writer.on_message_received(can.Message(timestamp=1.7e9, arbitration_id=1, data=b"\2"))
    content = bytearray(path.read_bytes())
    assert content[32:36] == struct.pack("<L", 3)
    content[32:36] = struct.pack("<L", announced)
    path.write_bytes(content)
    found = read_at_once(path)
    assert found == streamed(path)
    assert [frame.data for frame in found[0]] == [b"\1", b"\2"]
    assert (found[2] is None) if error is None else (error in str(found[2]))


def test_blf_times_beyond_exact_doubles_are_rounded_as_python_can_rounds_them(
    tmp_path: Path,
) -> None:
    ticks = np.random.default_rng(6).integers(2**53, 7 * 10**18, 2000).tolist()
    objects = [
        struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, 48, 1, 2, 0, 0, each)
        + struct.pack("<HBBL8s", 1, 0, 1, 1, b"\1")
        for each in ticks
    ]
    path = tmp_path / "late.blf"
    path.write_bytes(blf_file([(b"".join(objects), DEFLATED)]))
    assert read_at_once(path) == python_can_reads(path)


STORED, UNKNOWN, DEFLATED, CUT = range(4)  # ways of a container; the last is half of one


def blf_file(containers: list[tuple[bytes, int]], millisecond: int = 0) -> bytes:
    """Return a BLF file of containers, each with its way of compression."""
    content = b""
    for part, way in containers:
        packed = zlib.compress(part) if way in {DEFLATED, CUT} else part
        packed = packed[: len(packed) // 2] if way == CUT else packed
        size, method = 32 + len(packed), min(way, DEFLATED)
        content += struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, size, 10, method, len(part))
        content += packed + bytes(size % 4)
    start = (2026, 11, 6, 21, 9, 30, 5, millisecond)
    head = struct.pack(
        "<4sL8BQQLL8H8H", b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 144 + len(content), 0, 0, 0,
        *start, *start,
    )  # fmt: skip
    return head.ljust(144, b"\0") + content


WORD = st.integers(0, 2**32 - 1)
TICKS = st.one_of(st.integers(0, 10**13), st.integers(0, 2**64 - 1), st.just(0))


@st.composite
def objects(draw: st.DrawFn) -> bytes:
    """Draw an object of a BLF's inside, mostly as it should be."""
    kind = draw(st.sampled_from([1, 1, 86, 73, 100, 101, 96, 115]))
    can_id = draw(WORD)
    code = draw(st.integers(0, 8)) if draw(st.integers(0, 9)) else draw(st.integers(0, 255))
    flags = draw(st.sampled_from([0, 0, 0, 1, 0x80, 0x10]))
    payload = draw(st.binary(min_size=64, max_size=64))
    if kind in (1, 86):
        body = struct.pack("<HBBL8s", 1, flags, code, can_id, payload)
    elif kind == 100:
        code = draw(st.integers(0, 15)) if code <= 8 else code
        n = dlc2len(code) if draw(st.integers(0, 9)) else draw(st.integers(0, 255))
        body = struct.pack("<HBBLLBBB5x64s", 1, flags, code, can_id, 0, 0, 1, n, payload)
    elif kind == 101:
        code = draw(st.integers(0, 15)) if code <= 8 else code
        n = dlc2len(code) if draw(st.integers(0, 9)) else draw(st.integers(0, 255))
        data = payload[: draw(st.sampled_from([n, n, 0, 3]))]
        behind = draw(st.one_of(st.just(0), st.integers(72, 72 + len(data))))  # where data ends
        body = struct.pack(
            "<BBBBLLLLLLLHBBL", 1, code, n, 0, can_id, 0, flags, 0, 0, 0, 0, 0, 0, behind, 0
        )
        body += data
    else:
        body = payload[: draw(st.integers(0, 64))]
    version = draw(st.sampled_from([1, 1, 1, 1, 2, 3]))
    head = struct.pack("<LBxHQ", draw(st.integers(0, 3)), 0, 0, draw(TICKS))
    head += bytes(8) if version == 2 else b""
    size = 16 + len(head) + len(body)
    base = struct.pack("<4sHHLL", b"LOBJ", 16 + len(head), version, size, kind)
    padding = size % 4 if draw(st.booleans()) else -size % 4
    return base + head + body + bytes(padding)


def reads_over(content: bytearray) -> bool:
    """Return whether data of CAN FD ends behind its object: python-can then reads the next one's,
    if that is in the same container."""
    for match in re.finditer(b"LOBJ", content):
        head = content[match.start() :][:76]
        if len(head) == 76 and head[12] == 101:
            size = struct.unpack_from("<L", head, 8)[0]
            if max(head[67], head[75]) > size:  # of both versions of the header
                return True
    return False


@st.composite
def blf_files(draw: st.DrawFn) -> bytes:
    """Draw a BLF file whose objects cross its containers, sometimes spoilt."""
    found = draw(st.lists(st.one_of(objects(), st.just(b"")), max_size=20))
    content = bytearray(b"".join(found) * draw(st.sampled_from([1, 1, 3])))
    if content and draw(st.integers(0, 3)) == 0:
        content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
    assume(not reads_over(content))
    cuts = sorted(draw(st.lists(st.integers(0, len(content)), max_size=4)))
    ways = st.sampled_from([DEFLATED] * 9 + [STORED] * 4 + [UNKNOWN, CUT])
    containers = [
        (bytes(content[begin:end]), draw(ways)) for begin, end in pairwise([0, *cuts, len(content)])
    ]
    return blf_file(containers, draw(st.integers(0, 999)))


@settings(max_examples=150)
@given(content=blf_files(), chunk_bytes=st.sampled_from([1, 1, 200, 1 << 20]))
def test_blf_objects_of_every_kind_are_read_as_python_can_reads_them(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, chunk_bytes: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.blf"
    path.write_bytes(content)
    counters = LogCounters()
    with path.open("rb") as file:
        blocks = guarded(path, counters, blf.read_blocks(file, counters, chunk_bytes))
        found = outcome((frame for block in blocks for frame in frames_of(block)), counters)
    if "an object has no length" in str(found[2]):
        return  # python-can reads it for ever
    assert found == python_can_reads(path)
