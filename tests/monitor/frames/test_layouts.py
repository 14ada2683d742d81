"""Logs that other tools write as text are read, or called by their name."""

from itertools import pairwise
from pathlib import Path

import pytest

from monitor import cli
from monitor.base.errors import RecordingError
from monitor.decode.log_blocks import log_blocks
from monitor.frames.blocks import LogCounters
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks, read_frames
from monitor.grid.tables import is_table
from monitor.report.check import check
from tests.helpers.logs.bus_maps import OBD

SPY = "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node"
BYTES = "B1,B2,B3,B4,B5,B6,B7,B8,Value,Trigger,Signals"
KVASER = "Time,Channel,ID,Flags,DLC,Data0,Data1,Data2,Data3,Data4,Data5,Data6,Data7,Counter"
# one log per tool: 2 frames of 11 bits and one of 29, 10 ms apart; then what is no frame
TOOLS = {
    "printed.log": """\
Timestamp: 1700000000.000000    ID: 00c2    S Rx                DL:  8    01 02 03 04 05 06 07 a8
Timestamp: 1700000000.010000    ID: 00c3    S Tx                DL:  2    11 22     Channel: can0
Timestamp: 1700000000.020000    ID: 18fef100    X Rx     F BS   DL:  1    ff        Channel: can0
Timestamp: 1700000000.021000    ID: 00c2    S Rx   R            DL:  8              Channel: can0
""",
    "intrusion.txt": """Timestamp: 1479121434.850000  ID: 00c2  000  DLC: 8  01 02 03 04 05 06 07 a8
Timestamp: 1479121434.860000        ID: 00c3    000    DLC: 2    11 22
Timestamp: 1479121434.870000        ID: 18fef100    000    DLC: 1    ff
""",
    "intrusion.csv": """1478198376.389000,00c2,8,01,02,03,04,05,06,07,a8,R
1478198376.399000,00c3,2,11,22,R
1478198376.409000,18fef100,1,ff,T
""",
    "socketcand.txt": """< hi >
< ok >
< frame C2 23.400000 01 02 03 04 05 06 07 A8 >
< frame C3 23.410000 1122 >
< frame 18FEF100 23.420000 FF >
""",
    "canwise.log": """EV NUM/ERR F/F ID     LEN R/D   D0  D1  D2 TIMESTAMP  DD MM YYYY TIME
RX 01 SFF 000000C2 8 HEX   01  02  03  04  05  06  07  A8 0033200000 07.05.2022 14:10:08.135 1 2
TX 02 SFF 000000C3 2 HEX   11  22                         0033210000 07.05.2022 14:10:08.145 1 2
RX 03 EFF 18FEF100 1 HEX   FF                             0033220000 07.05.2022 14:10:08.155 1 2
""",
    "millis.csv": """millis,ID,DLC,B0,B1,B2,B3,B4,B5,B6,B7
500,0x0C2,8,0x01,0x02,0x03,0x04,0x05,0x06,0x07,0xA8
510,0x0C3,2,0x11,0x22
520,0x18FEF100,1,0xFF
""",
    "plain.csv": """millis,id,len,d0,d1,d2,d3,d4,d5,d6,d7
500,194,8,1,2,3,4,5,6,7,168
510,195,2,17,34
520,419361024,1,255
""",
    "scope.csv": """Acq,Packet,Start Time (ms),End Time (ms),ID,DLC,Data
1,1,500.2,500.4,C2,8,01 02 03 04 05 06 07 A8
1,2,510.2,510.4,C3,2,11 22
1,3,520.2,520.4,18FEF100,1,FF
""",
    "chinese.csv": """序号,系统时间,时间标识,CAN通道,传输方向,ID号,帧类型,帧格式,长度,数据
0,"17:16:04.110","0x1","ch1","接收","0x00C2","数据帧","标准帧","0x08","x| 01 02 03 04 05 06 07 A8"
1,"17:16:04.120","0x2","ch1","接收","0x00C3","数据帧","标准帧","0x02","x| 11 22"
2,"17:16:04.130","0x3","ch1","接收","0x18FEF100","数据帧","扩展帧","0x01","x| FF"
3,"17:16:04.140","0x4","ch1","接收","0x00C2","远程帧","标准帧","0x08","x| "
""",
    "console.log": """ (1700000000.000000)  can0  0C2   [8]  01 02 03 04 05 06 07 A8
 (1700000000.010000)  can0  0C3   [2]  11 22
 (1700000000.020000)  can0  18FEF100   [1]  FF
 (1700000000.030000)  can0  0C2   [0]  remote request
 (1700000000.031000)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME
""",
    "dates.log": """ (2023-11-14 22:13:20.000000)  can0  RX - -  0C2   [8]  01 02 03 04 05 06 07 A8
 (2023-11-14 22:13:20.010000)  can0  TX - -  0C3   [2]  11 22   '."'
 (2023-11-14 22:13:20.020000)  can0  RX - -  18FEF100   [1]  FF
""",
    "gvret.csv": """Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
1000,000000C2,false,Rx,0,8,01,02,03,04,05,06,07,A8,
11000,000000C3,false,Tx,0,2,11,22,00,00,00,00,00,00,
21000,18FEF100,true,Rx,0,1,FF,00,00,00,00,00,00,00,
""",
    "busmaster.log": """***BUSMASTER Ver 3.2.2***
***PROTOCOL CAN***
***HEX***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
23:59:59:9900 Rx 1 0x0C2 s 8 01 02 03 04 05 06 07 A8
00:00:00:0000 Tx 1 0x0C3 s 2 11 22
00:00:00:0100 Rx 1 0x18FEF100 x 1 FF
00:00:00:0200 Rx 1 0x0C2 sr 0
***[STOP LOGGING SESSION]***
""",
    "decimal.log": """***BUSMASTER Ver 3.2.2***
***DEC***
10:00:00:0000 Rx 1 194 s 8 1 2 3 4 5 6 7 168
10:00:00:0100 Rx 1 195 s 2 17 34
10:00:00:0200 Rx 1 419361024 x 1 255
""",
    "canhacker.trc": """Time   ID     DLC Data                    Comment
00,000 0C2    8   01 02 03 04 05 06 07 A8
00,010 0C3    2   11 22                   said
00,020 18FEF100 1 FF
""",
    "kvaser.txt": """Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir
 0    000000C2         8  01  02  03  04  05  06  07  A8       0.000000 R
 0    000000C3         2  11  22                               0.010000 R
 0    18FEF100 X       1  FF                                   0.020000 T
""",
    "memorator.txt": """                    Kvaser Memorator Log
                    ====================
Memorator Binary logfile created at: 2026-11-28 06:30:00
Settings:
   Format of data field: HEX
   CAN channel:          1 2
        Time Chan   Identifier Flags        DLC  Data                           Counter
===================================================================================
    0.000000  1          C2    Rx          8  01 02 03 04 05 06 07 A8             1
    0.005000  Trigger (type=0x1, active=0x00, pre-trigger=-1, post-trigger=-1)
    0.010000  1          C3    Tx          2  11 22                               2
    0.015000  1          C2    Rx       R  8  RTR                                 3
    0.020000  1    18FEF100x   Rx          1  FF                               1234
""",
    "zero.log": """ (000.000000)  can0  0C2   [8]  01 02 03 04 05 06 07 A8
 (000.010000)  can0  0C3   [2]  11 22
 (000.020000)  can0  18FEF100   [1]  FF
 (000.020000)  can0  0C2   [0]  remote request
""",
    "delta.log": """ (000.000000)  can0  0C2   [8]  01 02 03 04 05 06 07 A8
 (000.010000)  can0  0C3   [2]  11 22
 (000.010000)  can0  18FEF100   [1]  FF
 (000.002000)  can0  0C2   [0]  remote request
""",
    "memorator.csv": f"""{KVASER},AbsTime
0.500000,1,194,2,8,1,2,3,4,5,6,7,168,256,2023-11-14
0.510000,1,195,2,2,17,34,,,,,,,257,2023-11-14
0.520000,1,419361024,4,1,255,,,,,,,,3,2023-11-14
0.530000,1,194,3,8,,,,,,,,,4,2023-11-14
""",
    "memorator_hex.csv": f"""{KVASER}
0.500000,1,C2,2,8,01,02,03,04,05,06,07,A8,256
0.510000,1,C3,2,2,11,22,,,,,,,257
0.520000,1,18FEF100,4,1,FF,,,,,,,,3
""",
    "spy.csv": f"""Vehicle Spy 3 Bus Traffic File
Save Date,1/2/2023
ISO8601 Timestamp,2023-01-02T13:00:47.000019

{SPY},Arb ID,Remote,Xtd,{BYTES}
{SPY},PT,Trgt,Src,{BYTES}
1,2550.368,0.0,67371008,F,F,"HS CAN, $C2",HS CAN,,C2,F,F,01,02,03,04,05,06,07,A8,,,
2,2550.378,0.01,67371008,F,T,HS CAN $C3,HS CAN,,C3,F,F,11,22,,,,,,,,,
3,2550.388,0.01,67371008,F,F,HS CAN,HS CAN,,18FEF100,F,T,FF,,,,,,,,,,
4,2550.389,0.001,67371008,F,F,HS CAN $C2,HS CAN,,C2,T,F,,,,,,,,,,,
""",
    "drive.crtd": """1700000000.000000 CXX OVMS trace
1700000000.000000 1R11 0C2 01 02 03 04 05 06 07 A8
1700000000.010000 1T11 0C3 11 22
1700000000.020000 1R29 18FEF100 FF
1700000000.030000 CEV an event
""",
    "microchip.txt": """//---------------------------------
Microchip Technology Inc.
CAN BUS Analyzer
//---------------------------------
1000;RX;0x000000C2;8;0x01;0x02;0x03;0x04;0x05;0x06;0x07;0xA8;
1010;TX;0x000000C3;2;0x11;0x22;
1020;RX;0x18FEF100;1;0xFF;
""",
    "ixxat.csv": """ASCII Trace IXXAT V1
Date: 1.2.2023
"Time","Identifier (hex)","Format","Flags","Data (hex)"
"00:01:03.00","0C2","Std","","01 02 03 04 05 06 07 A8 "
"00:01:03.01","0C3","Std","","11 22 "
"00:01:03.02","18FEF100","Ext","","FF "
""",
    "canedge.csv": """TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes
1700000000.000000;1;C2;0;8;8;0;0;0;0;0;01020304050607A8
1700000000.010000;1;C3;0;2;2;0;0;0;0;0;1122
1700000000.020000;1;18FEF100;1;1;1;0;0;0;0;0;FF
""",
    "adapter.csv": """Index,System Time,Time Stamp,Channel,ID,Type,Format,Len,Data
0,10:00:00.1,0.500000,ch1,0x00C2,Data,Standard,0x08,x| 01 02 03 04 05 06 07 A8
1,10:00:00.1,0.510000,ch1,0x00C3,Data,Standard,0x02,x| 11 22
2,10:00:00.1,0.520000,ch1,0x18FEF100,Data,Extended,0x01,x| FF
3,10:00:00.1,0.530000,ch1,0x00C2,Remote,Standard,0x00,
""",
    "milliseconds.csv": """Zeit (ms);Bus;Type;CAN-ID;Len;B0;B1;B2;B3;B4;B5;B6;B7
500,0;1;Rx;C2h;8;01;02;03;04;05;06;07;A8
510,0;1;Tx;C3h;2;11;22;;;;;;
520,0;1;Rx;18FEF100h;1;FF;;;;;;;
""",
    "joined.csv": """time,addr,bus,data,d0
0.5,0xc2,0,0x01020304050607a8,1
0.51,0xc3,0,0x1122,17
0.52,0x18fef100,0,0xff,255
""",
    "relative.log": """***BUSMASTER Ver 3.2.2***
***HEX***
***RELATIVE MODE***
00:00:00:0000 Rx 1 0x0C2 s 8 01 02 03 04 05 06 07 A8
00:00:00:0100 Tx 1 0x0C3 s 2 11 22
00:00:00:0100 Rx 1 0x18FEF100 x 1 FF
""",
    "version.trc": """;$FILEVERSION=1.2
;$STARTTIME=46353.4166666667
     1)        500.0 1  Rx        00C2  8  01 02 03 04 05 06 07 A8
     2)        510.0 1  Tx        00C3  2  11 22
     3)        520.0 1  Rx    18FEF100  1  FF
""",
    "tshark.txt": """frame.time_epoch\tcan.id\tcan.len\tdata.data
1700000000.000000000\t194\t8\t01:02:03:04:05:06:07:a8
1700000000.010000000\t195\t2\t11:22
1700000000.020000000\t419361024\t1\tff
""",
    "cl2000.txt": """# Logger type: CL2000
# Value separator: ";"
Timestamp;Type;ID;Data
20261128T063000000;0;c2;01020304050607a8
20261128T063000010;0;c3;1122
20261128T063000020;1;18fef100;ff
""",
    "length_code.log": """(1700000000.000000) can0 0C2#01020304050607A8_B
(1700000000.010000) can0 0C3#1122
(1700000000.020000) can0 18FEF100#FF
""",
    "german.csv": """Zeit [s];Kanal;ID (hex);DLC;Daten
0,500000;1;C2;8;01 02 03 04 05 06 07 A8
0,510000;1;C3;2;11 22
0,520000;1;18FEF100;1;FF
""",
    "candump.txt": """(1700000000.000000) can0 0C2#01.02.03.04.05.06.07.A8
(1700000000.010000) can0 0C3#1122
(1700000000.020000) can0 18FEF100#FF
""",
    "colours.log": """ \x1b[34m(001.500000)\x1b[m can0 \x1b[31m0C2\x1b[m [8] 01 02 03 04 05 06 07 A8
 \x1b[34m(001.510000)\x1b[0m  can0  \x1b[31m0C3\x1b[0m   [2]  11 22
 \x1b[34m(001.520000)\x1b[0m  can0  \x1b[31m18FEF100\x1b[0m   [1]  FF
""",
}
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


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-8-sig", "gb18030"])
@pytest.mark.parametrize("name", ["gvret.csv", "dates.log", "plain.log", "chinese.csv"])
def test_the_encoding_of_a_redirected_output_does_not_matter(
    tmp_path: Path, name: str, encoding: str
) -> None:
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
        ("0C2 01 02\n0C3 11 22\n7E8 03 41 0D\n", "identifiers and data without times: not read"),
        ("CAN 1  000000C2 X 8 E.M 1.5 R\n   -> Speed 5.0 Enum\n", "without the frames' data: not"),
        ("ID,DATA_0,DATA_1,label\n194,1,2,R\n", "identifiers and data without times: not read"),
        (">010C\n41 0C 1A F8\n\n>010D\n41 0D 32\n", "an ELM327's requests and answers: not read"),
        ("t0C221122\rT18FEF1001FF\r", "an slcan adapter's own lines: not read"),
        ("    No. Time   Source\n      1 0.0    CAN  ID: 194\n", "Wireshark: not read, convert"),
        ('"No.","Time","Source"\n"1","0.1","ID: 194 (0xc2)"\n', "Wireshark: not read, convert"),
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


def test_a_log_of_names_instead_of_identifiers_shows_its_line(tmp_path: Path) -> None:
    path = tmp_path / "symbolic.asc"
    path.write_text("base hex timestamps absolute\n" + " 0.1 1  EngineData  Rx  d 1 FF\n" * 9)
    with pytest.raises(RecordingError, match=r"line 2 is '0[.]1 1 EngineData Rx d 1 FF'"):
        list(read_frames(path))


@pytest.mark.parametrize(
    ("header", "form", "is_decimal"),
    [
        ("Time Stamp,ID,LEN,D1,D2", "{}000,{:08X},2,FE,01", False),
        ("TimestampEpoch;ID;DLC;DataBytes", "{};{:X};2;FE01", False),
        ("Time (ms),ID (hex),Data", "{},{:X},FE 01", False),
        ("time_ms,id,data", "{},{:X}h,FE 01", False),
        ("time_ms,id,data", "{},{},FE 01", True),
        ("time_ms,addr,data", "{},{},FE 01", True),
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
def test_the_times_of_few_frames_keep_their_unit(
    tmp_path: Path, column: str, form: str, step_s: float
) -> None:
    path = tmp_path / "few.csv"
    rows = [f"{form.format(200 * i)},0x7E8,{i:02X}\n" for i in range(40)]
    path.write_text(f"{column},ID,Data\n" + "".join(rows))
    steps = {b.t_ns - a.t_ns for a, b in pairwise(read_frames(path))}
    assert steps == {round(step_s * 1e9)}


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
        # WHEN the map reads that identifier THEN both names are said
        with pytest.raises(RecordingError, match=r"0C2 is on the channels 'can\d' and 'can\d'"):
            list(read_blocks(path, channels=Channels(mapped=[0xC2])))
        # AND a chosen one gives its frames alone; an identifier of one channel is no matter
        chosen = list(read_blocks(path, channels=Channels("can0", [0xC2])))
        assert [int(d) for b in chosen for d in b.data[:, 0]] == list(range(0, 90, 2))
        assert sum(len(b.t_ns) for b in read_blocks(path, channels=Channels(mapped=[0xC9]))) == 135
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
