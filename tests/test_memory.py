"""The fault memory on disk: what it has stored outlives the process, whatever ends it."""

import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.dtc import CODES, Dtc, DtcStore, Status
from monitor.errors import RecordingError
from monitor.memory import SCHEMA_VERSION, Memory

KNOWN = sorted({code for group in CODES.values() for code in group})
dtcs = st.builds(
    Dtc,
    st.sampled_from(KNOWN),
    st.sampled_from(["", *CODES]),
    st.lists(st.sampled_from(sorted(CODES)), max_size=3, unique=True).map(tuple),
    st.integers(0, 255).map(Status),
    st.integers(0, 2**62),
    st.booleans(),
    st.integers(0, 40),
)

# Saves whole stores in a loop; says which one it has saved only after ``save`` has returned.
SAVES_IN_A_LOOP = """
import sys
from pathlib import Path
from monitor.dtc import CODES, Dtc
from monitor.memory import Memory

memory = Memory(Path(sys.argv[1]))
number = int(sys.argv[2])
codes = sorted({code for group in CODES.values() for code in group})
while True:
    number += 1
    memory.save([Dtc(code, t_ns=number) for code in codes])
    print(number, flush=True)
"""


def reopened(path: Path) -> tuple[Dtc, ...]:
    with closing(Memory(path)) as memory:
        return memory.load()


@settings(max_examples=30)
@given(st.lists(dtcs, max_size=10, unique_by=lambda dtc: dtc.code))
def test_codes_are_loaded_as_they_were_saved(
    tmp_path_factory: pytest.TempPathFactory, saved: list[Dtc]
) -> None:
    path = tmp_path_factory.mktemp("memory") / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save(saved)
    assert sorted(reopened(path), key=lambda d: d.code) == sorted(saved, key=lambda d: d.code)


def test_a_code_matures_over_processes_as_it_does_in_one(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    for expected in ("pending", "confirmed"):
        with closing(Memory(path)) as memory:
            store = DtcStore(memory.load())
            store.start_driving_cycle()
            store.fail("slow_symmetric", 5)
            memory.save(store.all)
        (stored,) = DtcStore(reopened(path)).active
        assert (stored.code, stored.fault, stored.state) == ("P0133", "slow_symmetric", expected)


def test_a_later_save_replaces_the_code_and_keeps_the_others(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save([Dtc("P0133", t_ns=1), Dtc("P2195", t_ns=1)])
        memory.save([Dtc("P0133", t_ns=2)])
    assert {d.code: d.t_ns for d in reopened(path)} == {"P0133": 2, "P2195": 1}


def test_a_new_memory_is_empty(tmp_path: Path) -> None:
    assert reopened(tmp_path / "dtc.db") == ()


def test_what_is_no_database_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    path.write_text("(1.0) can0 123#00\n" * 100)
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"dtc\.db: not a fault memory"):
        Memory(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("table", ["notes", "dtc"])
def test_a_database_of_another_program_is_refused_and_left_as_it_is(
    tmp_path: Path, table: str
) -> None:
    path = tmp_path / "notes.db"
    with closing(sqlite3.connect(path)) as db:
        db.execute(f"CREATE TABLE {table} (text TEXT)")
        db.commit()
    with pytest.raises(RecordingError, match=r"notes\.db: not a fault memory"):
        Memory(path)
    with closing(sqlite3.connect(path)) as db:
        names = [name for (name,) in db.execute("SELECT name FROM sqlite_master")]
    assert names == [table]


def test_another_schema_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    Memory(path).close()
    with closing(sqlite3.connect(path)) as db:
        db.execute(f"PRAGMA user_version={SCHEMA_VERSION + 1}")
    with pytest.raises(
        RecordingError, match=rf"dtc\.db: .* schema {SCHEMA_VERSION + 1}, wanted {SCHEMA_VERSION}"
    ):
        Memory(path)


def test_an_unknown_code_in_the_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save([Dtc("P9999")])
        with pytest.raises(RecordingError, match=r"dtc\.db: unknown trouble code 'P9999'"):
            memory.load()


def test_a_memory_without_its_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(sqlite3.connect(path)) as db:
        db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
    with closing(Memory(path)) as memory, pytest.raises(RecordingError, match=r"dtc\.db"):
        memory.load()


def test_a_folder_that_is_not_there_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere/dtc\.db"):
        Memory(tmp_path / "nowhere" / "dtc.db")


def test_a_save_that_fails_leaves_the_memory_as_it_was_and_usable(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save([Dtc("P0133", t_ns=1)])
        # GIVEN a save that breaks half way: the second row does not fit the table
        too_large = Dtc("P2195", t_ns=2**70)
        with pytest.raises((RecordingError, OverflowError)):
            memory.save([Dtc("P0133", t_ns=2), too_large])
        assert [d.t_ns for d in memory.load()] == [1]
        # THEN the next one works
        memory.save([Dtc("P0133", t_ns=3)])
    assert [d.t_ns for d in reopened(path)] == [3]


def test_two_processes_may_make_the_same_memory_at_once(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    code = "import sys, pathlib, monitor.memory as m; m.Memory(pathlib.Path(sys.argv[1]))"
    makers = [
        subprocess.Popen([sys.executable, "-c", code, path], stderr=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    for maker in makers:
        _, complaint = maker.communicate(timeout=60)
        assert maker.returncode == 0, complaint
    assert reopened(path) == ()


def test_a_kill_at_any_instant_loses_no_acknowledged_save(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    rng = random.Random(1)
    acknowledged = 0
    for _ in range(20):
        # GIVEN a process that saves in a loop
        saver = subprocess.Popen(
            [sys.executable, "-c", SAVES_IN_A_LOOP, path, str(acknowledged)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert saver.stdout is not None
        lines: list[str] = []
        reader = threading.Thread(target=lines.extend, args=(saver.stdout,))
        reader.start()
        # WHEN it is killed at a random instant, perhaps before it has opened the memory
        time.sleep(rng.uniform(0.02, 0.35))
        saver.send_signal(signal.SIGKILL)
        assert saver.wait(timeout=60) == -signal.SIGKILL
        reader.join(timeout=60)
        saver.stdout.close()
        if lines:
            acknowledged = int(lines[-1])
        # THEN the file is sound and holds the last acknowledged save, whole, or the one after
        if not path.exists():
            assert acknowledged == 0
            continue
        with closing(sqlite3.connect(path)) as db:
            assert db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        stored = reopened(path)
        numbers = {dtc.t_ns for dtc in stored} or {0}
        assert len(numbers) == 1
        assert len(stored) in (0, len(KNOWN))
        (number,) = numbers
        assert acknowledged <= number <= acknowledged + 1
        acknowledged = number
    assert acknowledged > 100  # the savers did save
