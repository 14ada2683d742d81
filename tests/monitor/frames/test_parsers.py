"""Which parser of candump text serves: the one that the installation announces, or numpy's."""

import sys
import tomllib
from pathlib import Path

import pytest

from monitor.cli import main
from monitor.frames import parsers
from monitor.frames.candump_blocks import Lines
from monitor.frames.lines import Bytes
from monitor.frames.logs import read_frames
from training.fleet import candump_parser

ROOT = Path(__file__).resolve().parents[3]
DRIVE = ROOT / "replay_logs" / "transient_micro_trips_v109_s113.blf"


def announce(folder: Path, value: str) -> None:
    """Lay a distribution into ``folder`` that announces a parser."""
    info = folder / "announced-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: announced\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{parsers.GROUP}]\ncompiled = {value}\n")


@pytest.fixture
def announced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Announce what pyproject.toml announces, however old the installation is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    announce(tmp_path, project["entry-points"][parsers.GROUP]["compiled"])
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("announced")
def test_the_compiled_parser_serves_for_long_logs_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, blf = tmp_path / "a.LOG", tmp_path / "b.blf"
    log.write_bytes(bytes(60))
    blf.write_bytes(bytes(1000))
    paths = [log, blf, log, tmp_path / "missing.log"]
    monkeypatch.setattr(parsers, "LEAST_BYTES", 120)
    assert parsers.parser_for(paths) is candump_parser.parse_lines
    monkeypatch.setattr(parsers, "LEAST_BYTES", 121)
    assert parsers.parser_for(paths) is None


@pytest.mark.usefixtures("announced")
def test_a_parser_whose_library_is_missing_or_broken_is_passed_over_and_the_log_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    monkeypatch.delitem(sys.modules, "training.fleet.candump_parser")
    monkeypatch.setitem(sys.modules, "numba", None)
    assert parsers.compiled_parser() is None
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "broken_parser.py").write_text("raise RuntimeError('cannot cache function')\n")
    announce(broken, "broken_parser:parse_lines")
    monkeypatch.syspath_prepend(broken)
    assert parsers.compiled_parser() is None
    assert "cannot cache function" in caplog.text


@pytest.mark.usefixtures("announced")
def test_a_replay_writes_the_same_bytes_with_the_compiled_parser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a drive as candump text
    log = tmp_path / "drive.log"
    lines = (
        f"({t_ns // 10**9}.{t_ns // 1000 % 10**6:06d}) can0 {can_id:03X}#{data.hex()}\n"
        for t_ns, can_id, _, data in read_frames(DRIVE)
    )
    log.write_text("".join(lines))
    own, compiled = candump_parser.parse_lines, []

    def parse_lines(text: Bytes) -> Lines:
        compiled.append(len(text))
        return own(text)

    monkeypatch.setattr(candump_parser, "parse_lines", parse_lines)
    written = []
    # WHEN it is replayed with numpy's parser and with the compiled one
    for least_bytes in (10**12, 0):
        monkeypatch.setattr(parsers, "LEAST_BYTES", least_bytes)
        assert not compiled
        files = [tmp_path / "out.json", tmp_path / "out.html"]
        main(["replay", str(log), "--quiet", "--json", str(files[0]), "--html", str(files[1])])
        written.append([path.read_bytes() for path in files])
    # THEN JSON and page are the same
    assert compiled
    assert written[0] == written[1]
