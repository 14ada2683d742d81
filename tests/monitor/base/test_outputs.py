"""What is written never replaces what is read or was recorded."""

import ast
from pathlib import Path

import pytest

from monitor import cli as o2mon
from monitor.base.files.outputs import numbered, replaced, unused
from tests.conftest import ROOT
from tests.helpers.logs.injected_frames import HEALTHY
from training import cli as o2train


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Give a recording of one's own."""
    path = tmp_path / "drive.blf"
    path.write_bytes(HEALTHY.read_bytes())
    return path


def test_a_log_that_cannot_be_made_leaves_the_one_that_was_there(
    drive: Path, tmp_path: Path
) -> None:
    # GIVEN a log, and a recording with a damaged container in its middle
    kept, damaged = tmp_path / "kept.log", tmp_path / "damaged.blf"
    kept.write_text("(1.0) can0 123#00\n")
    content = bytearray(drive.read_bytes())
    content[200_000] ^= 0x10
    damaged.write_bytes(content)
    # WHEN faults are to be put into what is left of it
    words = ["inject", str(damaged), "--out", str(kept), "--fault", "gain_low"]
    # THEN it fails, and nothing is lost or left behind
    assert o2mon.main(words) == 2
    assert kept.read_text() == "(1.0) can0 123#00\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["damaged.blf", "drive.blf", "kept.log"]


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
    words = ["fit", str(drive), "--out", str(locked / "model.onnx")]
    assert o2train.main(words) == 2
    assert f"{locked / 'model.onnx'}: the folder may not be written to" in capsys.readouterr().err


def test_a_result_takes_its_place_in_one_step_or_not_at_all(tmp_path: Path) -> None:
    # GIVEN a result of an earlier run behind a link, readable by all
    place, link = tmp_path / "result.json", tmp_path / "link.json"
    place.write_text("old")
    place.chmod(0o640)
    link.symlink_to(place)
    # WHEN the writing of the next fails half way
    with pytest.raises(RuntimeError), replaced(link) as begun:
        begun.write_text("ne")
        raise RuntimeError
    # THEN the old one is there, and nothing else
    assert place.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.json", "result.json"]
    # WHEN it succeeds, THEN the link, the suffix and the rights are kept
    with replaced(link) as begun:
        assert begun.suffix == ".json"
        begun.write_text("new")
        assert place.read_text() == "old"
    assert link.is_symlink()
    assert place.read_text() == "new"
    assert place.stat().st_mode & 0o777 == 0o640


def test_a_full_disk_is_told_in_one_line(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert o2mon.main(["replay", str(drive), "--quiet", "--json", "/dev/full"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "o2mon: /dev/full: cannot write it: No space left on device"
    )


WRITERS = {"write_text", "write_bytes", "savefig", "to_csv", "write_csv", "write_parquet"}
# these write into a temporary folder, into memory, or beside the place, and rename themselves
ALLOWED = {
    "monitor/base/files/outputs.py",
    "monitor/bus/link/recorder.py",  # writes frames as they come
    "monitor/memory/block.py",
    "monitor/sinks/json_lines.py",  # appends
    "training/jobs/cluster.py",  # renames, in a worker
    "training/jobs/model_bytes.py",
    "training/fleet/worker_kit.py",
    "training/fleet/places.py",
    "training/fleet/run.py",
    "training/narx/export.py",
    "training/recordings/files/table_files.py",
    "training/recordings/files/mf4_log.py",
}


def writes(path: Path) -> set[str]:
    """Return the calls of a module that write a file at its final place."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        is_own = name in ("write_text", "write_bytes") and isinstance(node.func, ast.Name)
        modes = [a.value for a in node.args[:2] if isinstance(a, ast.Constant)]
        if (name in WRITERS and not is_own) or (
            name == "open" and any(isinstance(m, str) and set(m) & set("wax") for m in modes)
        ):
            found.add(name)
    return found


def test_every_result_is_written_beside_its_place_and_renamed() -> None:
    modules = [p for package in ("monitor", "training") for p in (ROOT / package).rglob("*.py")]
    assert len(modules) > 300
    direct = {str(p.relative_to(ROOT)): writes(p) for p in modules}
    assert {name: calls for name, calls in direct.items() if calls and name not in ALLOWED} == {}
