import gzip
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import ConfigError, RecordingError
from monitor.base.signals import SIGNALS
from monitor.base.types import Frame, Quality
from monitor.frames.blocks import LogCounters
from monitor.frames.logs import read_frames
from monitor.grid.table_samples import table_block
from monitor.grid.tables import is_table, read_table
from tests.conftest import ROOT
from tests.helpers.logs.bus_maps import OWN
from training.recordings.files.can_log import broadcast, write_log
from training.recordings.files.frame_block import EncodedFrames

SUFFIXES = [".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".csv", ".csv.gz", ".trc", ".mf4"]
START_NS = 1_700_000_000_123_456_000


@pytest.fixture(scope="module")
def drive() -> EncodedFrames:
    t_ns = START_NS + np.arange(20) * 100_000_000
    return broadcast(OWN, t_ns, {"lambda_measured": np.linspace(0.8, 1.2, 20)})


@pytest.fixture(scope="module")
def folder(drive: EncodedFrames, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for suffix in SUFFIXES:
        write_log(folder / f"drive{suffix}", drive)
    return folder


def zeroed(frames: list[Frame]) -> list[Frame]:
    return [frame._replace(t_ns=frame.t_ns - frames[0].t_ns) for frame in frames]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_log_format_gives_the_frames_it_was_given(
    folder: Path, drive: EncodedFrames, suffix: str
) -> None:
    counters = LogCounters()
    frames = list(read_frames(folder / f"drive{suffix}", counters))
    assert zeroed(frames) == zeroed(list(drive.frames()))
    assert (counters.frames, counters.skipped) == (len(drive.t_ns), 0)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_log_that_was_cut_short_is_read_as_far_as_it_goes_and_says_so(
    folder: Path, tmp_path: Path, suffix: str
) -> None:
    every = list(read_frames(folder / f"drive{suffix}"))
    whole = (folder / f"drive{suffix}").read_bytes()
    path = tmp_path / f"cut{suffix}"
    rng = np.random.default_rng(1)
    for cut in [len(whole) - 2, *rng.integers(1, len(whole), 20).tolist()]:
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


def test_a_blf_whose_logger_was_killed_is_read_and_says_so(folder: Path, tmp_path: Path) -> None:
    whole = bytearray((folder / "drive.blf").read_bytes())
    whole[16:24] = (144).to_bytes(8, "little")  # the size in the header is written at the end
    path = tmp_path / "killed.blf"
    path.write_bytes(whole)
    counters = LogCounters()
    assert list(read_frames(path, counters)) == list(read_frames(folder / "drive.blf"))
    assert counters.is_cut
    assert "never finished" in counters.notes[0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.log", None, "No such file"),
        ("empty.log", b"", "the log is empty"),
        ("drive.txt", b"x", "its first lines are those of no CAN log; known are candump"),
        ("drive.dat", b"x", r"unknown log format '.dat', known are .log"),
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


def test_an_mf4_log_without_asammdf_names_the_extra(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(RecordingError, match=r"'\.\[mdf\]'"):
        read_frames(folder / "drive.mf4")


def table(tmp_path: Path, text: str, name: str = "t.csv") -> Path:
    path = tmp_path / name
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


def test_tables_and_logs_are_told_apart(folder: Path, tmp_path: Path) -> None:
    assert not any(is_table(folder / f"drive{suffix}") for suffix in SUFFIXES)
    assert is_table(table(tmp_path, "time_s,x\n0,1\n"))
    assert is_table(table(tmp_path, "time_s,x\n0,1\n", "t.csv.gz"))
    assert is_table(tmp_path / "t.parquet")
    assert not is_table(tmp_path / "missing.csv")


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz"])
def test_blank_cells_are_not_valid(tmp_path: Path, name: str) -> None:
    got = read_table(table(tmp_path, "time_s,x,y\n0,1,\n0.1,nan,4\n\n", name))
    assert got.names == ("x", "y")
    assert got.t_ns.tolist() == [0, 100_000_000]
    np.testing.assert_array_equal(got.values, [[1, math.nan], [math.nan, 4]])


def test_a_uniform_table_is_used_sample_for_sample_at_its_own_period(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,lambda_measured\n5,0.2\n5.05,1\n5.1,\n5.15,1.5\n5.2,\n")
    block = table_block(read_table(path), ["lambda_measured"])
    assert block.index.tolist() == [0, 1, 2, 3, 4]
    assert block.t_ns.tolist() == [5_000_000_000 + k * 50_000_000 for k in range(5)]
    # a blank between two values holds the first, one at the end has none
    good = Quality.GOOD
    assert block.quality[:, 0].tolist() == [Quality.OUT_OF_RANGE, good, good, good, Quality.INVALID]
    np.testing.assert_array_equal(block.values[:, 0], [math.nan, 1, 1, 1.5, math.nan])


def test_a_table_with_gaps_is_brought_onto_the_grid(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,x\n0,1\n0.05,3\n0.3,5\n2,7\n2.01,0\n")
    block = table_block(read_table(path), ["x"], 100_000_000)
    assert block.values[[0, 2], 0].tolist() == [2.0, 5.0]
    # no row for 1.7 s is a pause: the grid begins anew behind it
    assert len(block.t_ns) == 4
    assert block.quality[3, 0] == Quality.GAP
    assert block.t_ns[3] == 2_000_000_000


def test_a_table_follows_the_period_asked_for(tmp_path: Path) -> None:
    rows = "".join(f"{k * 0.05:.2f},{k}\n" for k in range(9))
    got = read_table(table(tmp_path, f"time_s,x\n{rows}"))
    assert table_block(got, ["x"], 100_000_000).values[:, 0].tolist() == [1.0, 3.5, 5.5]
    assert len(table_block(got, ["x"], 50_000_000).t_ns) == 9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the table is empty"),
        ("time_s,x\n", "no row of column names with rows of numbers"),
        ("x,time_s\n1,0\n", r"no profile knows its columns \(x, time_s\); give --profile"),
        ("time_s,x\n0,1\n1\n", "line 3: 1 cell, the header has 2"),
        ("time_s,x\n0,1\n1,abc\n", "line 3: column x is 'abc'"),
        ("time_s,x\n0,1\n,2\n", "line 3: time_s is not a number"),
        ("time_s,x\n0,1\n1.7e12,2\n", "line 3: time_s is not a number or no time in s"),
        ("time_s,x\n0,1\n1,2\n0.5,3\n", "line 4: time_s is 0.5 after 1"),
    ],
)
def test_a_table_that_cannot_be_is_refused_by_line(tmp_path: Path, text: str, message: str) -> None:
    path = table(tmp_path, text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_table(path)
    assert str(path) in str(caught.value)


def test_a_truncated_gzipped_table_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,x\n" + "".join(f"{k},{k * 7}\n" for k in range(500)), "t.csv.gz")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(RecordingError, match="cannot read it: Compressed"):
        read_table(path)


def test_a_columns_map_renames_and_scales(tmp_path: Path) -> None:
    path = table(tmp_path, "t_ms,AFR,other\n0,14.7,1\n100,29.4,2\n")
    columns = tmp_path / "columns.toml"
    columns.write_text(
        'time_s = { column = "t_ms", factor = 0.001 }\n'
        'lambda_measured = { column = "AFR", factor = 0.068027210884, offset = 0.0 }\n'
    )
    got = read_table(path, columns)
    assert got.names == ("t_ms", "AFR", "other", "lambda_measured")  # the others keep their names
    assert got.t_ns.tolist() == [0, 100_000_000]
    np.testing.assert_allclose(got.values[:, 3], [1, 2])


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("x = 3\n", ConfigError, "x is 3, a text is wanted"),
        ('x = { column = "a", gain = 2 }\n', ConfigError, "unknown key 'gain'"),
        ('x = { column = "a", factor = "2" }\n', ConfigError, "a number is wanted"),
        ("x = \n", ConfigError, "not a TOML file"),
        ('x = "b"\n', RecordingError, "no column 'b' for x, there are time_s, a"),
    ],
)
def test_a_columns_map_that_cannot_be_is_refused(
    tmp_path: Path, text: str, error: type[Exception], message: str
) -> None:
    columns = tmp_path / "columns.toml"
    columns.write_text(text)
    with pytest.raises(error, match=message):
        read_table(table(tmp_path, "time_s,a\n0,1\n"), columns)


def test_the_page_of_signals_has_every_name_with_its_unit_and_range() -> None:
    page = (ROOT / "docs" / "reference" / "signals.md").read_text(encoding="utf-8")
    rows = [row.strip("| ").split(" | ") for row in page.splitlines() if row.startswith("| `")]
    told = {name.strip("`"): (unit, plausible) for name, unit, _, plausible in rows}
    assert told == {s.name: (s.unit, f"{s.minimum:g} to {s.maximum:g}") for s in SIGNALS}
