"""Text tables of loggers: encodings, separators, units, clocks, marks, no value, cuts."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import ConfigError, RecordingError
from monitor.base.types import Quality
from monitor.frames.tables.cells import clock, is_number, number
from monitor.frames.tables.delimited import open_delimited
from monitor.frames.tables.raw_table import Notes, Wanted
from monitor.grid.table_samples import table_block
from monitor.grid.tables import read_table
from tests.helpers.logs.logger_files import cells_of, write_text_table

COLUMNS = {"Time": np.array([0.0, 0.1, 0.25]), "AFR": np.array([14.7, 14.25, 13.5])}


def table(tmp_path: Path, text: str, name: str = "t.csv") -> Path:
    path = tmp_path / name
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
@pytest.mark.parametrize(
    ("separator", "comma"), [(",", False), (";", True), ("\t", True), ("  ", True)]
)
@pytest.mark.parametrize("quoted", [False, True])
@pytest.mark.parametrize("units", [(), ("s", "°")])
def test_every_dialect_gives_the_same_numbers(
    tmp_path: Path, encoding: str, separator: str, comma: bool, quoted: bool, units: tuple[str, ...]
) -> None:
    path = write_text_table(
        tmp_path / "a.csv",
        COLUMNS,
        separator=separator,
        comma=comma,
        encoding=encoding,
        quoted=quoted,
        units=units,
        preamble=('"A logger, version 2"', '"Capture Date: Mon Sep 05"') if units else (),
    )
    raw = open_delimited(path)
    assert raw.names == ("Time", "AFR")
    assert tuple(column.unit for column in raw.columns) == (units or ("", ""))
    np.testing.assert_allclose(cells_of(raw)[0], np.column_stack(list(COLUMNS.values())))


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("cp1251", "Обороты двигателя"),
        ("shift_jis", "エンジン回転数"),
        ("gb18030", "发动机转速"),
        ("cp1252", "Régime à l'arrêt"),
    ],
)
def test_the_letters_tell_the_encoding(tmp_path: Path, encoding: str, name: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(f"Time;{name}\n0,1;900\n0,2;910\n".encode(encoding))
    assert open_delimited(path).names == ("Time", name)


def test_marks_repeated_headers_and_words_for_no_value(tmp_path: Path) -> None:
    path = tmp_path / "a.msl"
    path.write_text(
        '"Speeduino"\nTime\tRPM\tState\ns\trpm\t\n0\t1000\tOn\nMARK 001 - pulling - Mon\n'
        "0.1\t-\tOff\nTime\tRPM\tState\ns\trpm\t\n0.2\t∞\tOn\n0.3\t\tOff\n0.4\tn/a\tOn\n"
    )
    found, notes = cells_of(open_delimited(path))
    np.testing.assert_array_equal(found[:, 0], [0.0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(found[:, 1], [1000.0, *[np.nan] * 4])
    np.testing.assert_array_equal(found[:, 2], [1.0, 0.0, 1.0, 0.0, 1.0])
    assert notes.counts == {"markers": 1, "repeated_headers": 1}


@pytest.mark.parametrize(
    ("header", "first"),
    [("Time,RPM,B,A", "B"), ("RPM,Time,A,B", "RPM"), ("Lap,Time,RPM,A", "Lap"), ("t,n,x,y", "t")],
)
def test_a_header_with_other_columns_ends_the_table_and_is_told(
    tmp_path: Path, header: str, first: str
) -> None:
    path = table(tmp_path, f"Time,RPM,A,B\n0,900,1,2\n1,910,1,2\nnan,-,-,-\n{header}\n2,920,2,1\n")
    found, notes = cells_of(open_delimited(path))
    assert found[:2, 2].tolist() == [1.0, 1.0]
    assert len(found) == 3
    assert notes.lines == (f"read up to a header with other columns: {first}, …",)


def test_cells_that_are_no_number_are_told_and_a_minus_of_texts_is_one(tmp_path: Path) -> None:
    path = table(
        tmp_path,
        "Time,RPM,Trim\n0,900,\u22122.5\n1,14. Jul,(2)\n2,-,#NV\nPause,Pause,Pause\n3,910,1\n",
    )
    found, notes = cells_of(open_delimited(path))
    np.testing.assert_array_equal(found[:, 2], [-2.5, np.nan, np.nan, np.nan, 1.0])
    told = "6 unreadable cells left out, the first: line 3: column RPM is '14. Jul'"
    assert notes.lines == (told,)


def test_columns_apart_by_blanks_may_have_a_mark_before_their_names(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("# recorded by hand in May\n# Time  AFR\n  0.0 14.70  \n 10.5  9.81  \n")
    raw = open_delimited(path)
    assert raw.names[:2] == ("Time", "AFR")
    np.testing.assert_array_equal(cells_of(raw)[0][:, :2], [[0.0, 14.7], [10.5, 9.81]])
    # AND whole numbers are not one with blanks in its thousands
    path.write_text("ms rpm\n1 900\n2 910\n")
    np.testing.assert_array_equal(cells_of(open_delimited(path))[0], [[1.0, 900.0], [2.0, 910.0]])


def test_words_tell_closed_loop(tmp_path: Path) -> None:
    path = table(tmp_path, "Time,Fuel System Status\n0,Closed loop\n1,Open loop - cold\n2,-\n")
    raw = open_delimited(path)
    assert raw.columns[1].kind == "text"
    (block,) = raw.read([Wanted(1, ("closed",))], Notes())
    np.testing.assert_array_equal(block[:, 0], [1.0, 0.0, np.nan])


def test_clocks_with_and_without_hours_and_dates() -> None:
    assert clock("25:36.7") == 1536.7
    assert clock("16:37:18,69952") == pytest.approx(59838.69952)
    assert clock("12:00:01 AM") == 1.0
    assert clock("01:00:00 PM") == 13 * 3600.0
    day = clock("2026-03-07 00:00:00")
    assert day % 86400 == 0.0
    assert clock("07.03.2026 00:00:01") == clock("03/07/2026 00:00:01") == day + 1.0
    assert clock("7-Mar-2026 00:00:02.5") == day + 2.5
    assert clock("2026-03-07T00:00:03Z") == day + 3.0
    assert clock("2026-03-07T02:00:03.5+02:00") == clock("2026-03-06 19:00:03.5 -0500") == day + 3.5
    assert clock("20260307T000003.5Z") == clock("20260307T000003500") == day + 3.5
    zones = (
        "Sat Mar 7 00:00:04 2026",
        "Sat Mar 7 01:00:04 GMT+01:00 2026",
        "7.3.2026 01:00:04 GMT+1",
    )
    further = "Sat Mar 07 2026 01:00:04 GMT+0100 (CET)", "Sat, 7 Mar 2026 00:00:04 +0000"
    points = "2026/3/7 00.00.04,0", "20260307 000004", "March 7, 2026 00:00:04 UTC"
    assert {clock(each) for each in (*zones, *further, *points)} == {day + 4.0}
    assert clock("00:00:04 CET") == clock("1.00:00:04.0") == 4.0
    assert np.isnan(clock("14.7"))
    assert np.isnan(clock("12 100000"))


@pytest.mark.parametrize(
    "days",
    [
        ("12/11/2026", "13/11/2026"),
        ("11/12/2026", "12/12/2026"),
        ("31-ago-2026", "01-sep-2026"),  # a month that cannot be read
        ("28 février 2026", "1 mars 2026"),
    ],
)
def test_dates_with_the_day_first_go_on_over_midnight(
    tmp_path: Path, days: tuple[str, str]
) -> None:
    # the first date alone may as well begin with its month
    path = tmp_path / "log.csv"
    times = [f"{days[0]} 23:59:{s}" for s in (57, 58, 59)] + [
        f"{days[1]} 00:00:0{s}" for s in range(6)
    ]
    rows = [f"{time},{800 + n}" for n, time in enumerate(times)]
    path.write_text("Time,rpm\n" + "\n".join(rows) + "\n")
    (block,) = open_delimited(path).read([Wanted(0)], Notes())
    assert np.diff(block[:, 0]).tolist() == [1.0] * 8


def test_times_go_on_where_the_offset_from_utc_changes(tmp_path: Path) -> None:
    hours = ["02:59:59.5+02:00", "02:59:59.7+02:00", "02:59:59.9+02:00", "02:00:00.1+01:00"]
    rows = "".join(f"2026-10-25T{hour},{k}\n" for k, hour in enumerate(hours))
    path = table(tmp_path, f"Time,A\n{rows}")
    raw = open_delimited(path)
    assert raw.columns[0].kind == "clock"
    (block,) = raw.read([Wanted(0)], Notes())
    np.testing.assert_allclose(np.diff(block[:, 0]), 0.2, atol=1e-6)


def test_a_log_that_ends_in_a_row_is_read_to_that_row_and_says_so(tmp_path: Path) -> None:
    path = write_text_table(tmp_path / "a.csv", {"Time": np.arange(9.0), "A": np.arange(9.0)})
    path.write_bytes(path.read_bytes() + b"9")
    found, notes = cells_of(open_delimited(path))
    assert len(found) == 9
    assert notes.lines == ("cut short in line 11: 1 cell, the header has 2 columns",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "the table is empty"),
        (b"Time,RPM\n", "no row of column names"),
        (b"1,2\n3,4\n", "no row of column names"),
        (b"just some prose\nin two lines\n", "no row of column names"),
        (b"Time,RPM\n0,1\n1\n2\n2,3\n", "line 3: 1 cell, the header has 2 columns"),
        (b"Time,RPM,AFR\n1,2,3\n" + b"0,1\n" * 2, "line 3: 2 cells, the header has 3 columns"),
        (bytes(range(256)) * 20, "binary data"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(text)
    with pytest.raises(RecordingError, match=message) as caught:
        cells_of(open_delimited(path))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cell", ["1_0", "٣", "1__0"])
def test_what_python_alone_reads_as_a_number_is_none(cell: str, tmp_path: Path) -> None:
    assert not is_number(cell)
    assert math.isnan(number(cell))
    path = table(tmp_path, f"time_s,a\n0,1\n0.1,{cell}\n")
    with pytest.raises(RecordingError, match="a number is wanted"):
        read_table(path)


# The project's own tables, and columns by a map


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
