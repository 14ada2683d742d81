"""Text logs whose lines are damaged: a frame that cannot be read is never left out silently."""

from collections.abc import Callable
from pathlib import Path

import pytest

from monitor.base.errors import RecordingError
from monitor.base.types import Frame
from monitor.frames.blocks import LogCounters
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log

FRAMES = [Frame(i * 5_000_000, 0xC0 + i % 4, False, bytes([i, 1, 2, 3])) for i in range(40)]
HEADER = "date Wed Sep 27 09:14:00.000 am 2023\nbase hex  timestamps absolute\n"
EVENTS = """// version 7.0.0
no internal events logged
Begin Triggerblock Wed Sep 27 09:14:00.000 am 2023
   0.000000 Start of measurement
   0.000100 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
   0.000200 CAN 1 Status:chip status error active
   0.000300 J1939TP FEE3p 6 0 0 - Rx d 39 80 43 4F 4D 50 31
   0.000400 L1 0x2D Rx 8 01 02 03 04 05 06 07 08 checksum = B4
   0.000500 1  ErrorFrame
   0.000600 1  C3 Rx   r
   0.000700 SV: 2 0 1 ::System::Speed = 4
   1.000000 1  C0x             Rx   d 2 01 02  Length = 240000 BitCount = 124 ID = 192x
   2.000000 CANFD   1 Rx        C1          1 0 2  2 03 04    0 0 1000 0 0 0 0 0
End TriggerBlock
"""


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line.rstrip() + " 99 " + line.lstrip(),  # two frames on one line
        lambda line: "9" * 30 + line,
        lambda line: line.replace("Rx", "nan").replace("DT", "nan"),
        lambda line: line.replace(" ", ""),
        lambda line: line.replace(".", ";"),
        lambda line: ";" + line if "DT" in line else "8" + line,  # a frame in a comment
    ],
)
@pytest.mark.parametrize("kind", [".asc", ".trc"])
def test_a_line_that_is_no_frame_any_more_is_left_out_and_told(
    tmp_path: Path, kind: str, damage: Callable[[str], str]
) -> None:
    path = tmp_path / f"drive{kind}"
    write_log(path, FRAMES)
    assert len(list(read_frames(path))) == len(FRAMES)
    lines = path.read_text().splitlines(keepends=True)
    lines[-10] = damage(lines[-10])
    path.write_text("".join(lines))
    counters = LogCounters()
    assert len(list(read_frames(path, counters))) == len(FRAMES) - 1
    assert counters.damaged == 1
    assert f"1 line left out, the first: line {len(lines) - 9} is" in counters.notes[0]
    # AND more than a hundredth of such lines is refused
    path.write_text("".join([*lines, *lines[-10:-9] * 2]))
    with pytest.raises(RecordingError, match=r"after \d+ frames: line"):
        list(read_frames(path))


def test_events_of_an_asc_log_that_are_no_frames_pass(tmp_path: Path) -> None:
    path, counters = tmp_path / "drive.asc", LogCounters()
    path.write_text(HEADER + EVENTS)
    assert [frame.can_id for frame in read_frames(path, counters)] == [0xC0, 0xC1]
    assert counters.skipped == 2  # error frame and remote frame


def test_an_asc_log_begins_at_the_date_of_its_header(tmp_path: Path) -> None:
    path, dates = tmp_path / "drive.asc", {"Sat Nov 28 06:30:00.250 2026": 1795847400.25}
    dates |= {"Mit Dez 2 06:30:00.000 pm 2026": 1796236200.0, "Sat Xyz 28 06:30:00 2026": 0.0}
    for date, start_s in dates.items():
        path.write_text(f"date {date}\n{HEADER}{EVENTS}")
        times = [frame.t_ns / 1e9 for frame in read_frames(path)]
        assert times == pytest.approx([start_s + 1.0, start_s + 2.0], abs=1e-6)


def test_relative_times_of_an_asc_log_are_those_since_the_line_before(tmp_path: Path) -> None:
    # GIVEN a log with an event between two frames, its times since the beginning
    path = tmp_path / "absolute.asc"
    path.write_text(HEADER + EVENTS)
    absolute = list(read_frames(path))
    # WHEN the same log states each time since the line before
    lines, last_us = [HEADER.replace("absolute", "relative")], 0
    for line in EVENTS.splitlines():
        time, _, rest = line.strip().partition(" ")
        if "." not in time:
            lines.append(line)
            continue
        now_us = round(float(time) * 1e6)
        lines.append(f"   {(now_us - last_us) / 1e6:.6f} {rest}")
        last_us = now_us
    (tmp_path / "relative.asc").write_text("\n".join(lines) + "\n")
    # THEN its frames are the same
    assert list(read_frames(tmp_path / "relative.asc")) == absolute


LOGS = {
    "1.0": """;   Message Number, time, identifier, length
     1)      1059 0401 2 01 02
     2)      1841 FFFFFFFF  4  00 00 00 08 -- BUSHEAVY
     3)      2000 18EFC034 2 11 22
     4)      2001 0401 3 RTR
""",
    "1.1": """;$FILEVERSION=1.1
     1)      1059.0  Rx         0401  2  01 02
     2)      1283.2  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY
     3)      2000.0  Tx     18EFC034  2  11 22
     4)      2001.0  Rx         0401  3  RTR
""",
    "1.3": """;$FILEVERSION=1.3
     1)      1059.0 1  Rx        0401 -  2    01 02
     3)      2000.0 2  Rx    18EFC034 -  2    11 22
     4)      2001.0 1  Rx        0401 -  3    RTR
""",
    "2.0": """;$FILEVERSION=2.0
;$COLUMNS=N,O,T,I,d,l,D
      1      1059.000 DT     0401 Rx 2  01 02
      2      1283.231 ST          Rx    00 00 00 08
      3      2000.000 DT 18EFC034 Tx 2  11 22
      4      2001.000 RR     0401 Rx 4
""",
    "2.1": """;$FILEVERSION=2.1
;$COLUMNS=N,O,T,B,I,d,R,L,D
      1      1059.000 DT 1      0401 Rx -  2    01 02
      2      1283.231 EC      - 00 00
      3      1284.231 ER - - 5
      4      2000.000 DT 1  18EFC034 Tx -  2    11 22
      5      2001.000 RR 1      0401 Rx -  4
""",
}


@pytest.mark.parametrize("version", LOGS)
def test_each_version_of_trc_gives_its_frames_alone(version: str, tmp_path: Path) -> None:
    (tmp_path / "drive.trc").write_text(LOGS[version])
    counters = LogCounters()
    frames = list(read_frames(tmp_path / "drive.trc", counters))
    told = [(f.t_ns // 1_000_000, f.can_id, f.is_extended, f.data.hex()) for f in frames]
    assert told == [(1059, 0x401, False, "0102"), (2000, 0x18EFC034, True, "1122")]
    assert (counters.skipped, counters.damaged) == (1, 0)
