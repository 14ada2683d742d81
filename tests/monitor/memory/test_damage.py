"""Damaged files of the fault memory: repaired from the spare copy, or put aside and announced."""

import json
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from monitor.base.errors import RecordingError
from monitor.cli import main
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import Saved
from monitor.memory.reference import Reference
from monitor.memory.spare import spare_of
from monitor.memory.store import Memory
from tests.conftest import ROOT
from tests.helpers.memory_damage import (
    attacks,
    content,
    damaged,
    files_of,
    full_store,
    killed_copy,
    outcome,
    put,
    stored,
)

DAMAGES = 90  # of each kind of file set; the benchmark fuzz_memory does 10,000


@pytest.fixture(scope="module")
def memories(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, bytes]]:
    """Files of a memory that was closed, and of one that a kill left open."""
    folder = tmp_path_factory.mktemp("memory")
    path = folder / "o2.db"
    stored(path)
    closed = files_of(path)
    with closing(Memory(path, hold=True)) as memory:
        memory.save(full_store().saved)
        killed = files_of(killed_copy(path, folder / "killed"))
    assert "o2.db-wal" in killed
    return {"closed": closed, "killed": killed}


@pytest.mark.parametrize("kind", ["closed", "killed"])
def test_whatever_is_damaged_nothing_is_silent_and_no_start_fails(
    tmp_path: Path, memories: dict[str, dict[str, bytes]], kind: str
) -> None:
    # GIVEN a memory with codes and a reference
    folder = tmp_path / "folder"
    put(memories[kind], folder)
    _, _, saved, reference = content(folder / "o2.db")
    assert saved.dtcs
    assert reference.drives == 1
    # WHEN bits flip, sectors are lost or files are cut off, in one file or in several
    seen = [
        outcome(files, folder, (saved, reference))
        for files, _ in attacks(memories[kind], random.Random(5), DAMAGES)
    ]
    # THEN each start gives back everything, or says that it is lost and puts the files aside
    assert set(seen) == {"ok", "repaired", "lost"}


def test_damage_of_one_file_is_always_repaired(
    tmp_path: Path, memories: dict[str, dict[str, bytes]]
) -> None:
    folder, draw = tmp_path / "folder", random.Random(6)
    for kind, name in (("closed", "o2.db"), ("killed", "o2.db-wal"), ("closed", "o2.db-spare")):
        put(memories[kind], folder)
        _, _, *whole = content(folder / "o2.db")
        for _ in range(15):
            files = memories[kind] | {name: damaged(memories[kind][name], draw)}
            assert outcome(files, folder, (whole[0], whole[1])) in ("ok", "repaired")


def test_a_record_damaged_in_each_file_is_repaired_from_the_other(
    tmp_path: Path, memories: dict[str, dict[str, bytes]]
) -> None:
    # GIVEN one row damaged in the main file and another one in the spare copy
    put(memories["closed"], tmp_path / "folder")
    path = tmp_path / "folder" / "o2.db"
    _, _, *whole = content(path)
    with closing(sqlite3.connect(path)) as db:
        db.execute("UPDATE dtc SET status = status + 1 WHERE code = 'P0133'")
        db.commit()
    text = spare_of(path).read_text()
    assert '["dtc", "P2195"' in text
    spare_of(path).write_text(text.replace('["dtc", "P2195"', '["dtc", "P2196"', 1))
    # WHEN it is opened
    state, _, *found = content(path)
    # THEN everything is there again
    assert state == "repaired"
    assert found == whole


def test_a_memory_of_an_older_version_gets_a_spare_copy(tmp_path: Path) -> None:
    path = tmp_path / "o2.db"
    stored(path)
    spare_of(path).unlink()
    state, _, saved, _ = content(path)
    assert state == "ok"
    shutil.copy(path, tmp_path / "whole.db")
    path.write_bytes(b"")
    state, _, again, reference = content(path)
    assert (state, again, reference.drives) == ("repaired", saved, 1)


def test_the_page_that_holds_no_record_does_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "o2.db"
    stored(path)
    data = bytearray(path.read_bytes())
    unused = data.index(b"\0" * 200) + 100  # between the cells of a page
    data[unused] ^= 4
    path.write_bytes(data)
    assert content(path)[0] == "ok"


def test_a_lost_memory_is_announced_until_its_code_is_stored(
    tmp_path: Path, memories: dict[str, dict[str, bytes]]
) -> None:
    # GIVEN a memory that is lost
    path = tmp_path / "folder" / "o2.db"
    put(memories["closed"], path.parent)
    for file in (path, spare_of(path)):
        file.write_bytes(file.read_bytes()[: len(file.read_bytes()) // 2])
    # WHEN processes open it and are killed before they have judged a sample
    for _ in range(3):
        state, aside, saved, reference = content(path)
        assert (state, saved, reference) == ("lost", Saved(), Reference())
        assert aside == path.with_name("o2.db-damaged-1")
    # THEN the loss is forgotten only when its code is in the memory
    with closing(Memory(path, hold=True)) as memory:
        memory.save(Saved((Dtc("P0133", "slow_symmetric"),)))
    assert content(path)[0] == "lost"
    with closing(Memory(path, hold=True)) as memory:
        memory.save(Saved((Dtc("P062F", "memory_lost"),)))
    assert content(path)[0] == "ok"
    assert aside.exists()
    # and a second loss gets another name
    for file in (path, spare_of(path)):
        file.write_bytes(b"SQLite format 3\0 and nothing more")
    assert content(path)[1] == path.with_name("o2.db-damaged-2")


def test_a_damaged_memory_stays_locked_while_it_is_repaired_and_read(tmp_path: Path) -> None:
    path = tmp_path / "o2.db"
    stored(path)
    path.write_bytes(path.read_bytes()[:5000])
    with closing(Memory(path, hold=True)) as memory:
        assert memory.condition.state == "repaired"
        with pytest.raises(RecordingError, match="in use by a running monitor"):
            Memory(path, hold=True)
        assert content_read(path) == memory.load()
    # and a reader repairs nothing while another process works on the file
    data = path.read_bytes()
    with closing(Memory(path, hold=True)) as memory:
        path.write_bytes(data[:5000])
        with closing(Memory(path)) as reader:
            assert reader.condition.state == "repaired"
            assert reader.load().dtcs
            with pytest.raises(RecordingError, match="in use by a running monitor"):
                reader.save(Saved())
        assert path.stat().st_size == 5000
        assert memory.load().dtcs


def content_read(path: Path) -> Saved:
    with closing(Memory(path)) as memory:
        return memory.load()


def test_damage_under_a_running_monitor_ends_no_storing(tmp_path: Path) -> None:
    # GIVEN a monitor that has the memory open while its main file is destroyed
    path = tmp_path / "o2.db"
    stored(path)
    with closing(Memory(path, hold=True)) as memory:
        saved = memory.load()
        path.write_bytes(path.read_bytes()[:5000])
        # WHEN it stores the next change THEN the file is repaired and holds it
        memory.save(Saved((Dtc("P0133", "slow_symmetric", t_ns=9),)))
        assert memory.condition.state == "repaired"
    state, _, found, reference = content(path)
    assert state == "ok"
    assert [dtc.t_ns for dtc in found.dtcs] == [9] != [dtc.t_ns for dtc in saved.dtcs]
    assert reference.drives == 1


def replayed(path: Path, tmp_path: Path) -> tuple[int, dict[str, Any]]:
    log = next(ROOT.glob("replay_logs/healthy_micro_trips_*.blf"))
    out = tmp_path / "out.json"
    code = main(["replay", str(log), "--memory", str(path), "--json", str(out)])
    (recording,) = json.loads(out.read_text())["recordings"]
    return code, recording


def test_a_replay_on_a_lost_memory_says_so_sets_p062f_and_no_exit_code_1(
    tmp_path: Path, memories: dict[str, dict[str, bytes]], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "folder" / "o2.db"
    put(memories["closed"], path.parent)
    for file in (path, spare_of(path)):
        file.write_bytes(file.read_bytes()[:900])
    # WHEN a healthy drive is judged on a memory that is lost
    code, recording = replayed(path, tmp_path)
    # THEN it is judged, the loss is in text, JSON and codes, and it is no fault of the vehicle
    aside = path.with_name("o2.db-damaged-1")
    assert code == 0
    assert recording["memory"] == {"state": "lost", "set_aside": str(aside)}
    assert not recording["fault_flag"]
    assert [(d["code"], d["fault"], d["state"]) for d in recording["dtcs"]] == [
        ("P062F", "memory_lost", "pending")
    ]
    said = capsys.readouterr()
    assert "lost and begin anew" in said.err
    assert "P062F memory_lost (pending)" in said.out
    # and the next drive finds a good memory, and the code goes after it
    for codes in (["P062F"], []):
        code, recording = replayed(path, tmp_path)
        assert (code, recording["memory"]["state"]) == (0, "ok")
        assert [d["code"] for d in recording["dtcs"]] == codes


def test_dtc_says_what_happened_to_a_damaged_memory(
    tmp_path: Path, memories: dict[str, dict[str, bytes]], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "folder" / "o2.db"
    put(memories["closed"], path.parent)
    path.write_bytes(path.read_bytes()[:900])
    assert main(["dtc", "list", "--memory", str(path), "--json"]) == 0
    said = capsys.readouterr()
    assert "o2.db: the fault memory was damaged" in said.err
    assert "nothing is lost" in said.err
    found = json.loads(said.out)
    assert found["memory_state"] == {"state": "repaired", "set_aside": None}
    assert found["dtcs"]
    for file in (path, spare_of(path)):
        file.write_bytes(b"")
    assert main(["dtc", "clear", "--memory", str(path)]) == 0
    assert "lost and begin anew" in capsys.readouterr().err
    assert main(["dtc", "list", "--memory", str(path)]) == 0
    assert capsys.readouterr().err == ""
