"""Logs of every format: their frames as python-can reads them, of a cut one those before."""

import gzip
import struct
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pytest
from asammdf import MDF
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock
from monitor.frames import mdf
from monitor.frames.blocks import LogCounters, block_of, frames_of, joined
from monitor.frames.logs import frame_of, read_blocks, read_frames
from monitor.grid.tables import is_table
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import OWN
from tests.helpers.logs.read_outcome import START_NS, read_at_once, synthetic
from training.recordings.files.can_log import broadcast, write_log

SUFFIXES = [".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".csv", ".csv.gz", ".trc", ".mf4"]


@pytest.fixture(scope="module")
def drive() -> FrameBlock:
    t_ns = START_NS + np.arange(50) * 100_000_000
    return broadcast(OWN, t_ns, {"lambda_measured": np.linspace(0.8, 1.2, 50)})


@pytest.fixture(scope="module")
def folder(drive: FrameBlock, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for suffix in SUFFIXES:
        write_log(folder / f"drive{suffix}", drive)
    return folder


def zeroed(frames: list[Frame]) -> list[Frame]:
    return [frame._replace(t_ns=frame.t_ns - frames[0].t_ns) for frame in frames]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_log_format_gives_its_frames(folder: Path, drive: FrameBlock, suffix: str) -> None:
    counters = LogCounters()
    frames = list(read_frames(folder / f"drive{suffix}", counters))
    assert zeroed(frames) == zeroed(list(frames_of(drive)))
    assert (counters.frames, counters.skipped) == (len(drive.t_ns), 0)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_log_that_was_cut_short_is_read_as_far_as_it_goes_and_says_so(
    folder: Path, tmp_path: Path, suffix: str
) -> None:
    every = list(read_frames(folder / f"drive{suffix}"))
    whole = (folder / f"drive{suffix}").read_bytes()
    path = tmp_path / f"cut{suffix}"
    rng = np.random.default_rng(1)
    for cut in [len(whole) - 2, 100, *rng.integers(1, len(whole), 20).tolist()]:
        kept = whole[:cut]
        path.write_bytes(kept.rstrip(b"\r\n"))
        counters = LogCounters()
        try:
            frames = list(read_frames(path, counters))
        except RecordingError as error:
            assert str(path) in str(error)
            assert counters.frames == 0 or suffix == ".mf4"
            continue
        # THEN the frames are the first of the whole log, and the end is told
        assert frames == every[: len(frames)]
        assert counters.is_cut
        assert f"cut short after {len(frames)} frames" in counters.notes[-1]


@pytest.mark.parametrize("suffix", [".blf", ".log.gz"])
def test_a_damaged_compressed_log_never_passes(folder: Path, tmp_path: Path, suffix: str) -> None:
    whole = bytearray((folder / f"drive{suffix}").read_bytes())
    whole[len(whole) // 2] ^= 0x10
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match="damaged or cut short"):
        list(read_frames(path))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.log", None, "No such file"),
        ("empty.log", b"", "the log is empty"),
        ("drive.txt", b"x", "its first lines are those of no CAN log; known are candump"),
        (
            "drive.dat",
            b"x",
            r"unknown log format '.dat': give it the ending of what .* .log .*, for a table .csv",
        ),
        ("drive.parquet", b"x", "unknown log format '.parquet': a table; frames are wanted"),
        ("drive", b"x", "unknown log format ''"),
        ("drive.gz", b"x", "unknown log format ''"),
        ("blank.log", b"\n\n", "no CAN frames"),
        ("words.log", 2 * b"hello world again\n", "line 1 is 'hello world again'"),
        ("late.log", b"(1.0) can0 1#00\n" + 2 * b"(1.1) can0 1#0G\n", "after 1 frames: line 2"),
        ("odd.log", b"(1.0) can0 1#000\n", "no CAN frames in the log; 1 line left out"),
        ("short.log", b"(1.0) can0\n", "line 1"),
        ("binary.log", b"\xff\xfe\x00\x01\n", "no CAN frames"),
        ("noise.blf", b"x" * 500, "not a BLF file"),
        ("noise.mf4", b"x" * 500, "not an MDF file"),
        ("noise.log.gz", b"x" * 500, "Not a gzipped file"),
        ("other.csv", b"a,b\n1,2\n", "no CAN log"),
        ("noise.asc", b"date nonsense\n", "damaged|no CAN frames"),
        ("noise.trc", b"nonsense\n", "damaged|no CAN frames"),
    ],
)
def test_what_is_no_log_is_refused_by_name(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        list(read_frames(path))
    assert str(path) in str(caught.value)


def test_an_mf4_without_asammdf_names_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(RecordingError, match=r"'\.\[mdf\]'"):
        read_frames(folder / "drive.mf4")


def test_tables_and_logs_are_told_apart(folder: Path, tmp_path: Path) -> None:
    text = b"time_s,x\n0,1\n"
    for name, content in (("t.csv", text), ("t.csv.gz", gzip.compress(text))):
        (tmp_path / name).write_bytes(content)
    assert all(is_table(tmp_path / name) for name in ("t.csv", "t.csv.gz", "t.parquet"))
    assert not any(is_table(folder / f"drive{suffix}") for suffix in SUFFIXES)
    assert not is_table(tmp_path / "missing.csv")


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
@inputs(15)
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
    with can.LogReader(path) as reader:
        sent = [frame_of(m) for m in reader if not (m.is_error_frame or m.is_remote_frame)]
    read, wanted = sorted(found[0]), sorted(sent)  # MF4: in the order of time
    if suffix == ".asc" and wanted:  # python-can leaves out the date of the header
        read, wanted = zeroed(read), zeroed(wanted)
    assert read == wanted
    assert len(found[0]) == sum(not (m.is_error_frame or m.is_remote_frame) for m in messages)
    assert found[1].skipped == len(messages) - len(found[0])


UNCLOSED: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    # space that was never filled; the size that the header gets at the end; packed blocks
    "only zeros from byte": (".blf", lambda whole: whole + bytes(5000)),
    "never finished": (".blf", lambda whole: whole[:16] + struct.pack("<Q", 144) + whole[24:]),
    "never closed": (".mf4", lambda whole: b"UnFinMF " + whole[8:60] + b"\x25\0" + whole[62:]),
}


@pytest.mark.parametrize("note", UNCLOSED)
def test_a_log_that_was_never_closed_gives_all_frames_and_a_note(
    folder: Path, tmp_path: Path, note: str, capsys: pytest.CaptureFixture[str]
) -> None:
    suffix, left_open = UNCLOSED[note]
    path = tmp_path / f"open{suffix}"
    path.write_bytes(left_open((folder / f"drive{suffix}").read_bytes()))
    frames, counters, error = read_at_once(path)
    assert (frames, error) == (read_at_once(folder / f"drive{suffix}")[0], None)
    assert counters.is_cut
    assert note in counters.notes[0]
    assert capsys.readouterr().out == ""


def test_an_mf4_whose_last_block_is_shorter_than_it_says_gives_what_it_holds(
    folder: Path, tmp_path: Path
) -> None:
    # GIVEN an MF4 of a killed logger that had announced the length of its records beforehand
    path = tmp_path / "open.mf4"
    with MDF(folder / "drive.mf4") as whole:
        whole.save(path, compression=0)
    content = path.read_bytes()
    at = content.index(b"##DT")
    moved = bytearray(content) + bytes(-len(content) % 8)
    struct.pack_into("<Q", moved, content.index(struct.pack("<Q", at)), len(moved))
    moved[:8], moved[60:62] = b"UnFinMF ", bytes([0b101, 0])
    (length,) = struct.unpack_from("<Q", content, at + 8)
    path.write_bytes(moved + content[at : at + length * 2 // 3])
    # WHEN it is read THEN its whole frames are there, and the end is said
    frames, counters, error = read_at_once(path)
    every = read_at_once(folder / "drive.mf4")[0]
    assert error is None
    assert 0.6 * len(every) < len(frames) < 0.7 * len(every)
    assert frames == every[: len(frames)]
    assert "never closed" in counters.notes[0]


def test_a_gzipped_blf_is_read_as_the_plain_one(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "drive.blf.gz"
    path.write_bytes(gzip.compress((folder / "drive.blf").read_bytes()))
    assert read_at_once(path)[:2] == read_at_once(folder / "drive.blf")[:2]
    path.write_bytes(path.read_bytes()[:-9])
    found = read_at_once(path)
    assert found[:2:2] == read_at_once(folder / "drive.blf")[:2:2]
    assert "end-of-stream" in found[1].notes[0]


@pytest.mark.parametrize("suffix", [".log.gz", ".blf"])
def test_memory_stays_flat_with_the_length_of_a_log(tmp_path: Path, suffix: str) -> None:
    peaks = []
    for n in (20_000, 60_000):
        path = tmp_path / f"long{n}{suffix}"
        write_log(path, synthetic(n))
        tracemalloc.start()
        assert sum(len(block.t_ns) for block in read_blocks(path)) == n
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 100_000  # the frames between them take 840 kB


@inputs(20)
@given(st.lists(st.lists(st.integers(0, 60), max_size=25), max_size=4), st.integers(1, 7))
def test_channel_groups_of_an_mf4_are_merged_by_time(times: list[list[int]], most: int) -> None:
    groups, wanted = [], []
    for number, each in enumerate(times):
        frames = [Frame(t_ns, number, False, b"") for t_ns in sorted(each)]
        groups.append(iter([block_of(frames[k : k + most]) for k in range(0, len(frames), most)]))
        wanted += frames
    merged = [frame for block in mdf._merged(groups) for frame in frames_of(block)]
    assert sorted(merged) == sorted(wanted)
    assert [frame.t_ns for frame in merged] == sorted(frame.t_ns for frame in wanted)


def test_an_mf4_is_read_in_blocks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = joined(list(read_blocks(folder / "drive.mf4")))
    monkeypatch.setattr(mdf, "FRAMES", 64)
    blocks = list(read_blocks(folder / "drive.mf4"))
    assert max(len(block.t_ns) for block in blocks) <= 64
    for column, again in zip(whole, joined(blocks), strict=True):
        np.testing.assert_array_equal(column, again)
