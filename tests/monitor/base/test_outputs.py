"""What is written never replaces what is read or was recorded."""

from collections.abc import Callable
from pathlib import Path

import pytest

from monitor import cli as o2mon
from monitor.base.outputs import numbered, unused
from monitor.report.replay import shipped_model
from tests.helpers.injected_frames import HEALTHY
from training import cli as o2train


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Give a recording of one's own."""
    path = tmp_path / "drive.blf"
    path.write_bytes(HEALTHY.read_bytes())
    return path


@pytest.mark.parametrize(
    ("main", "words"),
    [
        (o2mon.main, "inject {} --out {} --fault gain_low"),
        (o2mon.main, "replay {} --json {}"),
        (o2mon.main, "replay {} --html {}"),
        (o2train.main, "table {} --out {}"),
        (o2train.main, "log {} --out {}"),
        (o2train.main, f"evaluate {{}} --json {{}} --model {shipped_model()}"),
    ],
)
def test_a_recording_is_not_written_over_by_what_is_made_of_it(
    main: Callable[[list[str]], int], words: str, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.format(drive, drive).split()) == 2
    assert f"{drive}: is read, too; choose another file to write" in capsys.readouterr().err
    assert drive.read_bytes() == HEALTHY.read_bytes()


def test_a_log_that_cannot_be_made_leaves_the_one_that_was_there(
    drive: Path, tmp_path: Path
) -> None:
    # GIVEN a log, and a recording that is cut short
    kept, cut = tmp_path / "kept.log", tmp_path / "cut.blf"
    kept.write_text("(1.0) can0 123#00\n")
    cut.write_bytes(drive.read_bytes()[:200_000])
    # WHEN faults are to be put into what is left of it
    words = ["inject", str(cut), "--out", str(kept), "--fault", "gain_low"]
    # THEN it fails, and nothing is lost or left behind
    assert o2mon.main(words) == 2
    assert kept.read_text() == "(1.0) can0 123#00\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cut.blf", "drive.blf", "kept.log"]


def test_a_drive_that_was_recorded_is_kept_and_the_next_one_gets_a_number(drive: Path) -> None:
    assert unused(drive) == drive.with_name("drive_2.blf")
    drive.with_name("drive_2.blf").write_bytes(b"x")
    assert unused(drive) == drive.with_name("drive_3.blf")
    empty = drive.with_name("empty.log")
    empty.touch()
    assert unused(empty) == empty
    assert numbered(Path("a/drive.log.gz"), 3) == Path("a/drive_3.log.gz")


def test_a_folder_is_no_file_to_write(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert o2mon.main(["replay", str(drive), "--json", str(drive.parent)]) == 2
    assert "is a folder, a file to write is wanted" in capsys.readouterr().err


def test_a_folder_without_rights_is_refused_before_the_work(
    drive: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a folder that may be read only, as os.access has it for all users but root
    locked = drive.parent / "locked"
    locked.mkdir()
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != locked)
    # WHEN a model is to be fitted into it
    words = ["fit", str(drive), "--out", str(locked / "model.onnx")]
    # THEN the command ends at once
    assert o2train.main(words) == 2
    assert f"{locked / 'model.onnx'}: the folder may not be written to" in capsys.readouterr().err
