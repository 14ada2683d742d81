"""Damaged files of the fault memory: repaired by the other file, or put aside and announced."""

import json
import random
from contextlib import closing
from pathlib import Path

import pytest

from benchmarks.damage.fuzz_memory import content, contents, damaged, memories, outcome, put
from monitor.base.config import shipped
from monitor.base.errors import RecordingError
from monitor.cli import main
from monitor.memory.block import Block
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.reference import Reference
from monitor.memory.store import Memory
from monitor.pipeline.entry import dtc_entry
from tests.helpers.logs.replays import replay_log, replays

Files = dict[str, bytes]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Files]:
    """Files of a memory that was closed, and of one that a kill left."""
    return memories(tmp_path_factory.mktemp("memory"))


@pytest.fixture
def path(tmp_path: Path, kept: dict[str, Files]) -> Path:
    put(kept["closed"], tmp_path / "folder")
    return tmp_path / "folder" / "o2.db"


def damage(path: Path, data: bytes | None = None, of: slice = slice(2)) -> None:
    """Cut the files of a memory off, or write something else into them."""
    for file in Block(path).files[of]:
        file.write_bytes(file.read_bytes()[:900] if data is None else data)


def test_damage_of_one_file_is_always_repaired(tmp_path: Path, kept: dict[str, Files]) -> None:
    draw, files = random.Random(6), kept["closed"]
    wholes = contents(files, tmp_path / "folder")
    for name in files:
        for _ in range(20):
            hit = files | {name: damaged(files[name], draw)}
            assert outcome(hit, tmp_path / "folder", wholes) == "repaired"


def test_of_two_files_that_a_kill_left_the_newer_counts(path: Path, kept: dict[str, Files]) -> None:
    new, old = contents(kept["killed"], path.parent)
    assert new != old
    put(kept["killed"], path.parent)
    assert content(path) == ("ok", None, *new)
    assert contents({file.name: file.read_bytes() for file in Block(path).files}, path.parent) == [
        new,
        new,
    ]


def test_a_file_that_is_gone_is_made_anew_and_the_line_says_how_to_begin_anew(path: Path) -> None:
    whole = content(path)
    path.unlink()
    with closing(Memory(path)) as memory:
        assert memory.condition.state == "repaired"
        assert memory.condition.says == (
            f"{path}: the fault memory was damaged: o2.db is missing, o2.db.b was whole "
            "(to begin anew, remove both); nothing is lost"
        )
    path.with_name("o2.db.b").unlink()
    assert content(path) == whole


def test_a_lost_memory_is_announced_until_its_code_is_stored(path: Path) -> None:
    damage(path)
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
    damage(path, b"o2mon and nothing more")
    assert content(path)[1] == path.with_name("o2.db-damaged-2")


def test_a_reader_repairs_nothing_while_another_process_works_on_the_memory(path: Path) -> None:
    damage(path, of=slice(1))
    with closing(Memory(path, hold=True)) as memory:
        assert memory.condition.state == "repaired"
        damage(path, of=slice(1))
        with closing(Memory(path)) as reader:
            assert reader.condition.state == "repaired"
            assert reader.load() == memory.load()
        assert path.stat().st_size == 900
        damage(path)
        with pytest.raises(RecordingError, match="in use by a running monitor"):
            Memory(path)
        # and damage under a running monitor ends no storing
        memory.save(Saved((Dtc("P0133", "slow_symmetric", t_ns=9),)))
    state, _, found, reference = content(path)
    assert state == "ok"
    assert [dtc.t_ns for dtc in found.dtcs] == [9]
    assert reference.drives == 1


def test_a_replay_on_a_lost_memory_says_so_sets_p062f_and_no_exit_code_1(
    tmp_path: Path, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(path)
    healthy = replay_log("healthy_micro_trips")
    code, (recording,) = replays(healthy, "--memory", path)
    # THEN it is judged, the loss is in text, JSON and codes, and it is no fault of the vehicle
    aside = path.with_name("o2.db-damaged-1")
    assert (code, recording["fault_flag"]) == (0, False)
    assert recording["memory"] == {"state": "lost", "set_aside": str(aside)}
    assert [(d["code"], d["fault"], d["state"]) for d in recording["dtcs"]] == [
        ("P062F", "memory_lost", "pending")
    ]
    said = capsys.readouterr()
    assert "lost and begin anew" in said.err
    assert "P062F memory_lost (pending)" in said.out
    # and the next drive finds a good memory, and the code goes after it
    for codes in (["P062F"], []):
        code, (recording,) = replays(healthy, "--memory", path)
        assert (code, recording["memory"]["state"]) == (0, "ok")
        assert [d["code"] for d in recording["dtcs"]] == codes


def test_a_code_set_at_time_zero_is_one_of_this_drive() -> None:
    (lost,) = DtcStore().fail("memory_lost", 0)
    assert dtc_entry(lost, 0, 1.0)["t_s"] == 0.0
    assert dtc_entry(lost.next_cycle(shipped().profile), 0, 1.0)["t_s"] is None


def test_dtc_tells_of_a_damaged_memory(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage(path, of=slice(1))
    assert main(["dtc", "list", "--memory", str(path), "--json"]) == 0
    said = capsys.readouterr()
    assert "o2.db: the fault memory was damaged" in said.err and "nothing is lost" in said.err
    found = json.loads(said.out)
    assert found["dtcs"] and found["memory_state"] == {"state": "repaired", "set_aside": None}
    damage(path, b"")
    assert main(["dtc", "clear", "--memory", str(path)]) == 0
    assert "lost and begin anew" in capsys.readouterr().err
    assert main(["dtc", "list", "--memory", str(path)]) == 0
    assert capsys.readouterr().err == ""
