"""PEAK's text logs of every version: the columns that a header tells, or the version's own."""

from pathlib import Path

import pytest

from monitor.frames.blocks import LogCounters
from monitor.frames.logs import read_frames

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
}


@pytest.mark.parametrize("version", LOGS)
def test_each_version_gives_its_frames(version: str, tmp_path: Path) -> None:
    (tmp_path / "drive.trc").write_text(LOGS[version])
    counters = LogCounters()
    frames = list(read_frames(tmp_path / "drive.trc", counters))
    told = [(f.t_ns // 1_000_000, f.can_id, f.is_extended, f.data.hex()) for f in frames]
    assert told == [(1059, 0x401, False, "0102"), (2000, 0x18EFC034, True, "1122")]
    assert (counters.skipped, counters.damaged) == (1, 0)
