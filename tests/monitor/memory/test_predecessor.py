"""A fault memory of schema 4 (SQLite with a spare copy in text) is converted once, or refused."""

import hashlib
import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from monitor.base.errors import RecordingError
from monitor.cli import main
from monitor.memory import obd_records
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import Saved
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio
from monitor.memory.reference import Reference
from monitor.memory.store import Memory

ROWS = (
    ["dtc", "P0133", "transient", "slow_symmetric,gain_low", 0xAF, 5, 2, 0, 1],
    ["dtc", "P2195", "", "", 0x50, 0, 0, 0, 0],
    ["freeze_frame", 0, "P2195", 4, '{"lambda": 1.5}'],
    ["freeze_frame", 1, "P0133", 5, '{"lambda": 1.0, "latest": {"t_ns": 9, "lambda": 1.1}}'],
    ["permanent", 0, "P2195", "biased_lean"],
    ["permanent", 1, "P0133", "transient"],
    ["result", "response", "lag_s", 0.5, -1.0, 1.0],
    ["ratio", "response", 3, 4],
    ["counted", "ignition_cycles", 7],
    ["counted", "distance_with_mil_km", 1.5],
    ["completed", "response"],
    ["reference", "sha", -0.01, 0.02, 0.97, 4],
)
SAVED = Saved(
    dtcs=(
        Dtc("P0133", "transient", ("slow_symmetric", "gain_low"), Status(0xAF), 5, 2, 0, 1),
        Dtc("P2195", status=Status(0x50)),
    ),
    freeze_frames=(
        FreezeFrame("P2195", 4, {"lambda": 1.5}),
        FreezeFrame("P0133", 5, {"lambda": 1.0}),
    ),
    latest_frames=(FreezeFrame("P0133", 9, {"lambda": 1.1}),),
    permanent={"P2195": "biased_lean", "P0133": "transient"},
    results=(obd_records.TestResult("response", "lag_s", 0.5, -1.0, 1.0),),
    ratios=(Ratio("response", 3, 4),),
    counts=Counts(7, distance_with_mil_km=1.5),
    completed=frozenset({"response"}),
)


def checksum(row: list[object]) -> str:
    return hashlib.sha256(json.dumps(row).encode()).hexdigest()[:16]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A memory of schema 4."""
    path = tmp_path / "o2.db"
    with closing(sqlite3.connect(path)) as db:
        db.execute("CREATE TABLE dtc (code TEXT)")
        db.commit()
    digest = hashlib.sha256("".join(sorted(map(checksum, ROWS))).encode()).hexdigest()
    rows = [["head", 4, "0123456789abcdef", 12, "", digest], *ROWS]
    lines = [f"{checksum(row)} {json.dumps(row)}\n" for row in rows]
    path.with_name("o2.db-spare").write_text("".join(lines))
    path.with_name("o2.db-wal").touch()
    return path


@pytest.mark.parametrize("main_file", ["whole", "damaged", "gone"])
def test_a_memory_of_the_schema_before_is_converted(path: Path, main_file: str) -> None:
    if main_file == "damaged":
        path.write_bytes(b"no SQLite format")
    elif main_file == "gone":
        path.unlink()
    for _ in range(2):
        with closing(Memory(path, hold=True)) as memory:
            assert memory.condition.state == "ok"
            assert memory.load() == SAVED
            assert list(memory.load().permanent) == ["P2195", "P0133"]
            assert memory.reference("sha") == Reference(-0.01, 0.02, 0.97, 4)
        names = {file.name for file in path.parent.iterdir()}
        assert names == {"o2.db", "o2.db.b"}


def test_a_memory_without_a_whole_spare_copy_is_refused_in_one_line_and_left(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spare, before = path.with_name("o2.db-spare"), path.read_bytes()
    text = spare.read_text()
    for damage in ("", text[:-9], text.replace("0.97", "0.98"), text.replace(text[:300], "", 1)):
        spare.write_text(damage)
        with pytest.raises(RecordingError, match=r"an earlier version .* let that version repair"):
            Memory(path)
        assert spare.read_text() == damage
    spare.unlink()
    assert main(["dtc", "list", "--memory", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "o2.db: not a fault memory, or one of an earlier version (SQLite)" in line
    assert path.read_bytes() == before
