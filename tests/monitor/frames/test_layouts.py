"""Logs that other tools write as text are read, or called by their name."""

import gzip
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import pytest

from monitor import cli
from monitor.base.errors import RecordingError
from monitor.decode.log_blocks import log_blocks
from monitor.frames.blocks import LogCounters
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks, read_frames
from monitor.frames.text.layouts import UNREAD, layout_of
from monitor.grid.tables import is_table
from monitor.report.check import check
from tests.helpers.logs.bus_maps import OBD

# one log per tool: 2 frames of 11 bits and one of 29, 10 ms apart; then what is no frame
TOOLS = {path.name: path.read_text("utf-8") for path in Path(__file__).parent.glob("tools/*/*")}
DATA = [(0xC2, False, "01020304050607a8"), (0xC3, False, "1122"), (0x18FEF100, True, "ff")]


def of_tool(tmp_path: Path, name: str) -> Path:
    path = tmp_path / name
    path.write_text(TOOLS[name])
    return path


@pytest.mark.parametrize("name", TOOLS)
def test_a_text_log_of_another_tool_gives_its_frames(tmp_path: Path, name: str) -> None:
    path, counters = of_tool(tmp_path, name), LogCounters()
    frames = list(read_frames(path, counters))
    assert [(f.can_id, f.is_extended, f.data.hex()) for f in frames] == DATA
    steps = [round((b.t_ns - a.t_ns) / 1e6) for a, b in pairwise(frames)]
    assert steps == [10, 10]
    assert counters.notes == []
    assert not is_table(path)
    assert cli.main(["check", str(path), "--write-profile", str(tmp_path / "p.toml")]) == 2


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-8-sig", "gb18030"])
@pytest.mark.parametrize("name", ["gvret.csv", "dates.log", "plain.log", "chinese.csv"])
def test_the_encoding_of_outputs_does_not_matter(tmp_path: Path, name: str, encoding: str) -> None:
    plain = "".join(f"(1.0{i}0000) can0 0C{i}#0{i}\n" for i in range(4))
    text = TOOLS.get(name, plain)
    path, same = tmp_path / name, tmp_path / f"same_{name}"
    path.write_bytes(text.encode(encoding))
    same.write_text(text)
    assert list(read_frames(path)) == list(read_frames(same))


@pytest.mark.parametrize("name", TOOLS)
def test_one_broken_line_costs_a_note_and_many_the_log(tmp_path: Path, name: str) -> None:
    path = of_tool(tmp_path, name)
    path.write_text(TOOLS[name] + "17;broken 0.0\n")
    counters = LogCounters()
    assert len(list(read_frames(path, counters))) == len(DATA)
    assert "1 line left out" in counters.notes[0]
    path.write_text(TOOLS[name] + "17;broken 0.0\n" * 9)
    with pytest.raises(RecordingError, match="17;broken"):
        list(read_frames(path))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Vehicle Spy Message History\nLine,Abs Time(Sec)\n", "not read, convert it with Vehicle"),
        ("Time,Channel,ID,Length\n0.1,0,0C2,1,FF\n", "frames as CSV: not read"),
        ("  can0  0C2   [2]  11 22\n", "candump without times"),
        ("ready\nID: 0xC2 DLC: 2 Data: 0x11 0x22\n", "a sketch's own print of frames without"),
        ("-----\nGet data from ID: 0xC2\n11\t22\t\n", "a sketch's own print of frames without"),
        ("00C2 [2] 11 22 \n00C3 [1] ff \n", "candump without times"),
        ("0C2#1122\n0C3#\n18FEF100#FF", "candump without times"),
        ("0xC2A,1,00\n0xC3A,1,01\n0xC2A,1,02\n", "identifiers and data without times: not read"),
        ("0C2 01 02\n0C3 11 22\n7E8 03 41 0D\n", "identifiers and data without times: not read"),
        ("CAN 1  000000C2 X 8 E.M 1.5 R\n   -> Speed 5.0 Enum\n", "without the frames' data: not"),
        ("id,dlc,b0,b1\n100,2,00,08\n101,2,38,31\n", "identifiers and data without times: not"),
        (
            '"ID","PGN","B1","B2"\n"0CF00400","61444","F6","7D"\n' * 2,
            "identifiers and data without",
        ),
        ("ID,DATA_0,DATA_1,label\n194,1,2,R\n", "identifiers and data without times: not read"),
        (">010C\n41 0C 1A F8\n\n>010D\n41 0D 32\n", "an ELM327's requests and answers: not read"),
        ("t0C221122\rT18FEF1001FF\r", "an slcan adapter's own lines: not read"),
        ("t0C221122T18FEF1001FFt0C31FF", "an slcan adapter's own lines: not read"),
        ("    No. Time   Source\n      1 0.0    CAN  ID: 194\n", "Wireshark: not read, convert"),
        ('"No.","Time","Source"\n"1","0.1","ID: 194 (0xc2)"\n', "Wireshark: not read, convert"),
        ("1.5 0C2 1 02\n2.5 0C3 1 03\n3.5 0C2 1 04\n", "rows of frames without names of columns"),
        ("7 0C2 1 02\n8 0C3 1 03\n9 0C2 1 04\n", "rows of frames without names of columns"),
        (" (1.0)  can0  0C2   [2]  11`22\n", "candump -S or -i: not read, convert it with candump"),
    ],
)
@pytest.mark.parametrize("name", ["drive.csv", "drive.log", "drive.txt"])
def test_a_known_format_that_is_not_read_is_called_by_its_name(
    tmp_path: Path, name: str, text: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_text(text)
    assert cli.main(["check", str(path)]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            gzip.compress(b"Time,RPM", mtime=0),
            "its content is packed with gzip: its name must end in .gz",
        ),
        (b"PK\3\4" + bytes(99), "its content is an archive or a workbook: unpack it"),
        (b"LOGG\x90" + bytes(99), "its content is that of .blf, and its name must end so"),
        (b"MDF     4.10" + bytes(99), "its content is that of .mf4"),
    ],
)
@pytest.mark.parametrize("name", ["drive.csv", "drive.log", "drive.asc"])
def test_the_content_of_another_format_is_called_by_its_name(
    tmp_path: Path, name: str, content: bytes, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert cli.main(["check", str(path)]) == 2
    assert said in capsys.readouterr().err


def test_a_text_log_may_begin_as_another_format(tmp_path: Path) -> None:
    for name in "LOGGER 2", "MDF export":
        (tmp_path / "drive.log").write_text(f"{name}\n" + "(1.000000) can0 123#00\n" * 9)
        assert len(list(read_frames(tmp_path / "drive.log"))) == 9


def test_a_binary_format_is_called_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "drive.pcapng").write_bytes(bytes(99))
    with pytest.raises(RecordingError, match=r"a capture: not read, convert it with tshark -T"):
        read_blocks(tmp_path / "drive.pcapng")


def test_names_in_place_of_identifiers_may_come_late_and_alone_they_are_damage(
    tmp_path: Path,
) -> None:
    path, rows = tmp_path / "mixed.asc", [f"{i / 100:.2f} 1 C2 Rx d 1 FF\n" for i in range(2000)]
    rows += [f"{i / 100:.2f} 1 Oil Rx d 1 FF ID = 195\n" for i in range(2000, 2100)]
    path.write_text("base hex timestamps absolute\n" + "".join(rows))
    assert [frame.can_id for frame in read_frames(path)] == [0xC2] * 2000 + [0xC3] * 100
    path.write_text("base hex timestamps absolute\n" + " 0.1 1  EngineData  Rx  d 1 FF\n" * 9)
    with pytest.raises(RecordingError, match=r"line 2 is .*EngineData.*, a frame of"):
        list(read_frames(path))


@pytest.mark.parametrize(
    "line",
    [
        " " * 60_000 + "1",
        "1.0 1 A Rx d 8" + " 01" * 60_000 + " ID",
        "1.0 1 A Rx d 1 01" + " " * 60_000 + "x",
    ],
)
def test_a_hostile_line_costs_itself_and_little_time(tmp_path: Path, line: str) -> None:
    path, counters = tmp_path / "hostile.asc", LogCounters()
    path.write_text(f"base hex timestamps absolute\n0.1 1 0C2 Rx d 1 01\n{line}\n")
    assert len(list(read_frames(path, counters))) == counters.damaged == 1


@pytest.mark.parametrize(
    "row", ["0.1,C2,{}x,01,02", "0.1,C2,,01{}x", "10:00:00{}x", "0.1{}", "{}17"]
)
def test_blanks_cost_a_table_of_frames_little_time(tmp_path: Path, row: str) -> None:
    path, counters, blanks = tmp_path / "hostile.csv", LogCounters(), " " * 16_000
    good = "0.1,C2,1,01,02\n"
    path.write_text(f"Time,ID,Bus{blanks[:6000]}x,D0,D1\n{good}{good}{row.format(blanks)}\n")
    begun_s = time.process_time()
    assert len(list(read_frames(path, counters))) + counters.damaged == 3
    assert time.process_time() - begun_s < 1.0


def test_a_counter_of_microseconds_goes_on_when_it_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    counts = [(4294000000 + 100_000 * i) % (1 << 32) for i in range(30)]
    path.write_text("micros,id,d0\n" + "".join(f"{count},0C2,01\n" for count in counts))
    steps = {b.t_ns - a.t_ns for a, b in pairwise(read_frames(path))}
    assert steps == {100_000_000}


@pytest.mark.parametrize(
    "times_s",
    [
        [0.0, 0.01, 0.02, 0.03, 0.05, 0.04, 0.06, 0.08, 0.07],
        [0.0, 0.01, 0.02, 0.03, 0.04, 0.0, 0.01, 0.02, 0.03, 0.04],  # two drives in a file
        [0.0, 0.01, 0.02, 9.0, 0.03, 0.04, 0.05, 0.06],  # a clock that was off once
    ],
)
def test_frames_out_of_order_behind_a_zero_are_no_times_since_the_line_before(
    tmp_path: Path, times_s: list[float]
) -> None:
    path = tmp_path / "drive.log"
    path.write_text("".join(f"({each:010.6f}) can0 0C2#01\n" for each in times_s))
    assert [frame.t_ns / 1e9 for frame in read_frames(path)] == times_s


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 0, 0, 0], [0, 20, 10, 30]])
def test_rows_of_frames_with_times_since_1970_need_no_steps(
    tmp_path: Path, order: list[int]
) -> None:
    path, times_ms = tmp_path / "drive.txt", [1_700_000_000_000 + each for each in order]
    path.write_text("".join(f"{each} 0C2 2 01 02\n" for each in times_ms))
    assert [frame.t_ns // 1_000_000 for frame in read_frames(path)] == times_ms


def test_the_first_cells_of_a_table_of_frames_may_be_empty(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("Bus\tTime\tID\tD0\tD1\n" + "".join(f"\t0.{i}\t0C2\t01\t0{i}\n" for i in "123"))
    assert [frame.data.hex() for frame in read_frames(path)] == ["0101", "0102", "0103"]


@pytest.mark.parametrize("text", ["0", "ID 0x1 "])
def test_no_long_line_takes_long_to_name_what_is_not_read(text: str) -> None:
    line, begun_s = text * (40_000 // len(text)), time.process_time()
    for each in UNREAD["text"]:
        assert not re.search(each["begins"], line, re.I | re.A | re.M)
    assert time.process_time() - begun_s < 2.0


@pytest.mark.parametrize(
    "line",
    [
        '{"time": 1500, "id": "1A0", "dlc": 2, "data": "0102"}',
        "2026-12-01 10:00:00.5,1500,40,14",  # a table of numbers without names
        "1700000000.5,1500,40,14",
        "10:00:00.500,1500,40,14",
        "1.12.2026 12:00:00 ID: 0x1A0 DLC: 2 Data: 01 02",
        "1500000 us ID: 0x1A0 DLC: 2 Data: 01 02",
    ],
)
def test_frames_with_other_labels_or_times_are_not_read_as_those_of_a_sketch(
    tmp_path: Path, line: str
) -> None:
    path = tmp_path / "drive.txt"
    path.write_text(f"{line}\n" * 9)
    with suppress(RecordingError):  # that it is not read
        assert layout_of(path).layout is None


def test_parameter_groups_of_busmaster_are_read_as_far_as_a_frame_carries_them(
    tmp_path: Path,
) -> None:
    path, counters = tmp_path / "j1939.log", LogCounters()
    row = "10:00:00:{} 1 1cec{}00 0x00EC00 BROADCAST 00  FF  007 Tx {} {}\n"
    short, long = row.format("0100", "ff", 3, "00 EE 07 "), row.format("0200", "fe", 99, "00 " * 99)
    path.write_text(f"***BUSMASTER Ver 3.2***\n***PROTOCOL J1939***\n***HEX***\n{short}{long}")
    frames = list(read_frames(path, counters))
    assert [(f.can_id, f.is_extended, f.data.hex()) for f in frames] == [
        (0x1CECFF00, True, "00ee07")
    ]
    assert counters.notes == []


@pytest.mark.parametrize(
    ("header", "form", "is_decimal"),
    [
        ("Time Stamp,ID,LEN,D1,D2", "{}000,{:08X},2,FE,01", False),
        ("TimestampEpoch;ID;DLC;DataBytes", "{};{:X};2;FE01", False),
        ("Time (ms),ID (hex),Data", "{},{:X},FE 01", False),
        ("time_ms,id,data", "{},{:X}h,FE 01", False),
        ("time_ms,id,data", "{},{},FE 01", True),
        ("Rx Time (ms),id_dec,data", "{},{},FE 01", True),
        ("Time (0.1 ms),ID (dec),ID (hex),data", "{0}0,{1},{1:X},FE 01", False),
    ],
)
def test_identifiers_of_digits_alone_are_hexadecimal_unless_something_tells_otherwise(
    tmp_path: Path, header: str, form: str, is_decimal: bool
) -> None:
    ids = [0x100, 0x110, 0x200, 0x280, 0x300, 0x316, 0x329, 0x350, 0x430, *[0x545] * is_decimal]
    path = tmp_path / "digits.csv"
    rows = [form.format(10 * i, each) for i, each in enumerate(ids)]
    path.write_text(header + "\n" + "\n".join(rows) + "\n")
    assert [frame.can_id for frame in read_frames(path)] == ids


@pytest.mark.parametrize("row", ["0.1,C2,01,02,03", '"0.1","C2","01","02","03"', "0.1,C2,01,02,R"])
def test_each_byte_of_a_table_has_a_cell_quoted_or_not_and_rows_may_be_shorter(
    tmp_path: Path, row: str
) -> None:
    path = tmp_path / "bytes.csv"
    path.write_text(f"Time,ID,D0,D1,D2,Label\n{row}\n{row}\n")
    wanted = "0102" if "R" in row else "010203"
    assert [frame.data.hex() for frame in read_frames(path)] == [wanted] * 2


@pytest.mark.parametrize(
    ("header", "row", "data"),
    [("Data", "[]", [b"\x01\x02", b""]), ("D0,D1", "Error,", [b"\x01\x02"])],
)
def test_a_list_may_be_empty_and_a_first_byte_that_is_none_makes_no_frame(
    tmp_path: Path, header: str, row: str, data: list[bytes]
) -> None:
    path = tmp_path / "bytes.csv"
    first = "01,02" if "," in header else '"[1, 2]"'
    path.write_text(f"Time,CAN_ID,{header}\n0.1,C2,{first}\n0.2,C3,{row}\n")
    assert [frame.data for frame in read_frames(path)] == data


def test_a_length_code_of_can_fd_keeps_all_bytes(tmp_path: Path) -> None:
    path, data = tmp_path / "fd.csv", bytes(range(48))
    path.write_text(f"time;ID;IDE;DLC;DataLength;DataBytes\n0.1;1A0;0;14;48;{data.hex()}\n")
    assert [frame.data for frame in read_frames(path)] == [data]


def test_numbers_without_letters_and_leading_zeros_are_decimal(tmp_path: Path) -> None:
    path = tmp_path / "canking.txt"
    path.write_text("Chn Identifier Flg   DLC  D0\n" + " 0  298  2  7  21  0.010000 R\n" * 2)
    assert [(frame.can_id, frame.data) for frame in read_frames(path)] == [(298, b"\x07\x15")] * 2


@pytest.mark.parametrize(
    ("column", "form", "step_s"),
    [
        ("time_ms", "{:.0f}", 0.2),  # few frames, as of requests and answers
        ("Time", "{:.0f}", 0.2),
        ("timestamp", "1795857{:06.0f}", 0.2),  # ms since 1970
        ("timestamp", "1795857{:06.0f}000", 0.2),
        ("Time", "0.{:06.0f}", 0.0002),
    ],
)
def test_few_frames_keep_their_unit(tmp_path: Path, column: str, form: str, step_s: float) -> None:
    path = tmp_path / "few.csv"
    rows = [f"{form.format(200 * i)},0x7E8,{i:02X}\n" for i in range(40)]
    path.write_text(f"{column},ID,Data\n" + "".join(rows))
    steps = {b.t_ns - a.t_ns for a, b in pairwise(read_frames(path))}
    assert steps == {round(step_s * 1e9)}


@pytest.mark.parametrize(
    ("names", "form"),
    [
        ("Time (abs),Time (rel)", "1795847400{0},{0}"),
        ("Time (rel),x", "{0},1"),
        ("Time (s),Time_ms", "0.{0},{0}"),
        ("Time since start (s),x", "0.{0},1"),
    ],
)
def test_another_time_beside_that_of_a_frame_is_no_part_of_it(
    tmp_path: Path, names: str, form: str
) -> None:
    path = tmp_path / "two.csv"
    rows = [f"{form.format(100 + 7 * i)},C2,{i:02X}\n" for i in range(40)]
    path.write_text(f"{names},ID,Data\n" + "".join(rows))
    steps = {round((b.t_ns - a.t_ns) / 1e3) for a, b in pairwise(read_frames(path))}
    assert steps == {7000}


@pytest.mark.parametrize(
    ("names", "order", "said"),
    [
        ("Time", range(40, 0, -1), "its time falls from row to row: rising times are wanted"),
        ("Time", [10 + i % 3 for i in range(40)], "its time falls from row to row"),
        ("Timestamp", range(0, 40_000, 1000), "its timestamp may be in ms or µs: call it time_ms"),
        ("Cycle Time", range(40), "no CAN log|not read"),
        ("Time Diff", range(40), "no CAN log|not read"),
    ],
)
def test_times_that_may_be_others_are_refused(
    tmp_path: Path, names: str, order: Sequence[int], said: str
) -> None:
    path = tmp_path / "odd.csv"
    path.write_text(f"{names},ID,Data\n" + "".join(f"{each},C2,00\n" for each in order))
    with pytest.raises(RecordingError, match=said):
        list(read_frames(path))


def test_rows_of_two_channels_may_be_a_little_out_of_order(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    path.write_text("Time (s),ID,Data\n" + "".join(f"{i - i % 2 * 1.5},C2,00\n" for i in range(40)))
    assert len(list(read_frames(path))) == 40


def test_two_logs_in_one_file_keep_their_dates_and_bases(tmp_path: Path) -> None:
    path, begun_s = tmp_path / "two.asc", 1795847400
    log = "date Sat Nov 28 {} 2026\nbase {}\n 0.5 1 100 Rx d 1 11\n 0.25 1 100 Rx d 1 10\n"
    forms = ("06:30:00", "hex timestamps absolute"), ("06:40:00", "dec timestamps relative")
    path.write_text("".join(log.format(*each) for each in forms))
    frames = [(round(f.t_ns / 1e9 - begun_s, 3), f.can_id, f.data[0]) for f in read_frames(path)]
    assert frames == [
        (0.5, 0x100, 0x11),
        (0.25, 0x100, 0x10),
        (600.5, 100, 11),
        (600.75, 100, 10),
    ]
    # AND so do two traces of PEAK
    path = tmp_path / "two.trc"
    day = ";$FILEVERSION=1.1\n;$STARTTIME={}\n  1)  500.0  Rx 0100 1 11\n"
    path.write_text(day.format(46354.25) + day.format(46354.5))
    assert [f.t_ns / 1e9 for f in read_frames(path)] == [1795847400.5 - 1800, 1795847400.5 + 19800]


def test_milliseconds_since_1970_may_have_a_decimal_comma(tmp_path: Path) -> None:
    path = tmp_path / "comma.csv"
    path.write_text("Zeit;ID;Daten\n1795857000000,5;0C2;01\n1795857000010,5;0C2;02\n")
    assert [frame.t_ns // 1000 for frame in read_frames(path)] == [
        1795857000000500,
        1795857000010500,
    ]


@pytest.mark.parametrize(
    "name",
    ["Chan", "Port", "can_bus", "Bus ID", "CAN Channel", "Channel No.", "iface", "Port,Ch."],
)
def test_channels_of_a_table_of_frames_are_told_apart_whatever_they_are_called(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / "both.csv"
    more = "USB1," * name.count(",")  # the adapter's, beside the channel
    rows = [f"0.{i},{more}{1 + i % 2},C2,0{i % 2}\n" for i in range(9)]
    path.write_text(f"Time,{name},CAN ID,Data\n" + "".join(rows))
    with pytest.raises(RecordingError, match="0C2 is on the channels '1' and '2'"):
        list(read_blocks(path, channels=Channels("", [0xC2])))


@pytest.mark.parametrize(
    ("columns", "cells", "kept"),
    [
        ("ID Type", "Extended", [(0xC2, True)]),
        ("IsExtended", "True", [(0xC2, True)]),
        ("Frame Type", "Extended Data", [(0xC2, True)]),
        ("Frame Type", "Extended Remote", []),
        ("Format", "Extended Frame", [(0xC2, True)]),
        ("Type,Error", "Error,No error", []),
        ("Type", "Error Frame", []),
        ("Type,RTR", "Data,1", []),  # two columns that may say it
        ("Format,Type", "Standard,Data", [(0xC2, False)]),
        ("Message", "Engine", [(0xC2, False)]),  # a name
        ("Frame", "RemoteStart", [(0xC2, False)]),
        ("ASCII,DLC", '"A,0X02', [(0xC2, False)]),  # a quote that opens nothing
        ("Format,Type", '"Standard" , "Data"', [(0xC2, False)]),
    ],
)
def test_a_table_of_frames_tells_their_kind_in_words(
    tmp_path: Path, columns: str, cells: str, kept: list[tuple[int, bool]]
) -> None:
    path = tmp_path / "kinds.csv"
    blank = "," * columns.count(",")
    path.write_text(f"Time,ID,{columns},Data\n0.1,C2,{cells},01-02\n0.2,C3,{blank},03-04\n")
    found = [(frame.can_id, frame.is_extended) for frame in read_frames(path)]
    assert found == [*kept, (0xC3, False)]


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("Time,ID,B1,B0", "0.1,C2,02,01", "frames as CSV: not read"),  # the last byte first
        ("Time,ID,Data", "0.1,C2,102030405", "line 2 is '0.1,C2,102030405', a frame of"),
        ("Seconds,Microseconds,ID,Data", "10,250000,C2,01", "its time stands in two columns, sec"),
        ("Time,ms,ID,Data", "10:00:00,250,C2,01", "its time stands in two columns, time and ms:"),
        ("Time (ticks),ID,Data", "100,C2,01", r"its column time \(ticks\) counts in an unknown"),
    ],
)
def test_columns_that_cannot_be_read_rightly_are_refused(
    tmp_path: Path, header: str, row: str, said: str
) -> None:
    path = tmp_path / "odd.csv"
    path.write_text(f"{header}\n{row}\n{row}\n")
    with pytest.raises(RecordingError, match=said):
        list(read_frames(path))


def test_a_row_with_another_kind_of_time_is_a_damaged_line(tmp_path: Path) -> None:
    path, counters = tmp_path / "mixed.csv", LogCounters()
    rows = [f"{i / 10},C2,{i:02X}\n" for i in range(99)]
    path.write_text("Time,ID,Data\n0x1F,C2,00\n" + "".join(rows) + "12:00:00.1,C2,00\n")
    assert len(list(read_frames(path, counters))) == 99
    assert "2 lines left out, the first: line 2 is" in counters.notes[0]


def test_a_log_of_two_buses_is_refused_unless_one_is_chosen(tmp_path: Path) -> None:
    # GIVEN a log whose channels use one identifier for different things
    path = tmp_path / "both.log"
    engine = [f"(1.{i:06d}) can0 0C2#{i:02X}\n" for i in range(0, 90, 2)]
    body = [f"(1.{i:06d}) can1 0C2#FF\n(1.{i:06d}) can1 0C9#00\n" for i in range(1, 90, 2)]
    mixed = [line for pair in zip(engine, body, strict=True) for line in pair]
    for lines in (engine + body, body + engine, mixed):
        path.write_text("".join(lines))
        # WHEN maps read it THEN both names are said, though their messages have the same name
        with pytest.raises(RecordingError, match=r"0C2 is on the channels 'can\d' and 'can\d'"):
            list(read_blocks(path, channels=Channels("", [0xC2, 0xC9])))
        # AND a chosen one gives its frames alone; an identifier of one channel is no matter
        chosen = list(read_blocks(path, channels=Channels("can0", [0xC2])))
        assert [int(d) for b in chosen for d in b.data[:, 0]] == list(range(0, 90, 2))
        assert sum(len(b.t_ns) for b in read_blocks(path, channels=Channels("", [0xC9]))) == 135
    printed = "Timestamp: {0}.5 ID: 0c2 S Rx DL: 1 0{0} Channel: can{0}\n"
    path.write_text("".join(map(printed.format, (0, 1))))
    assert [b.data[0, 0] for b in read_blocks(path, channels=Channels("can1"))] == [1]
    with pytest.raises(RecordingError, match="no channel can7, there are 'can0', 'can1'"):
        list(read_blocks(path, channels=Channels("can7", [0xC2])))


def test_answers_of_29_bits_are_decoded_as_those_of_11(tmp_path: Path) -> None:
    # GIVEN the same answers of an engine under both identifiers, and one of its gearbox
    seen = []
    for name, identifier in (("obd29.log", "18DAF110"), ("obd11.log", "7E8")):
        path = tmp_path / name
        answers = (f"(1.{i:06d}) can0 {identifier}#04410C1{i % 10}70AAAAAA\n" for i in range(99))
        path.write_text("(0.5) can0 18DAF118#04410C0000AAAAAA\n" + "".join(answers))
        # WHEN the log is checked, and a bus that brings its frames
        for blocks in (log_blocks(path, OBD), read_blocks(path)):
            speed = next(s for s in check(blocks, OBD).signals if s.name == "engine_speed_rpm")
            seen.append((speed.maximum, speed.last_ns))
            assert speed.count >= 99
    # THEN all say the same
    assert len(set(seen)) == 1
    assert seen[0][0] == pytest.approx(0x1970 / 4)


def test_an_answer_gives_all_parameters_that_were_asked_for_in_one_request(tmp_path: Path) -> None:
    # GIVEN answers with several parameters in one frame and in three, and one whose end is unknown
    path, log = tmp_path / "obd.log", "(1.{:06d}) can0 {}#{}\n"
    three = "100F410C19700578", "210F430B28348000", "228000AAAAAAAAAA"
    lines = [*three, "06410C19700F43AA", "06410C1970F043AA"]
    for identifier in ("7E8", "18DAF110"):
        path.write_text("".join(log.format(i, identifier, each) for i, each in enumerate(lines)))
        # WHEN the log is checked
        found = {s.name: s for s in check(log_blocks(path, OBD), OBD).signals}
        # THEN each has its value, and what cannot be told apart has none
        wanted = {"engine_speed_rpm": 1628.0, "coolant_temperature_degc": 80.0}
        wanted |= {"manifold_temperature_degc": 27.0, "manifold_pressure_kpa": 40.0}
        wanted |= {"lambda_measured": 1.0}
        assert {name: found[name].maximum for name in wanted} == pytest.approx(wanted)
        assert [found[n].count for n in ("engine_speed_rpm", "manifold_temperature_degc")] == [3, 2]
