"""The fault memory on disk: what it has stored outlives the process, whatever ends it."""

import json
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.config import shipped
from monitor.base.errors import RecordingError
from monitor.memory import obd_records
from monitor.memory.codes import CODES, TESTS
from monitor.memory.content import checksum_of
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.reference import Reference, Seen
from monitor.memory.store import SCHEMA_VERSION, Memory
from tests.helpers.examples import inputs

KNOWN = sorted({code for group in CODES.values() for code in group})
numbers = st.integers(0, 2**62)
names = st.sampled_from(["", *CODES])
quantities = st.floats(allow_nan=False, allow_infinity=False)
dtcs = st.builds(
    Dtc,
    st.sampled_from(KNOWN),
    names,
    st.lists(st.sampled_from(sorted(CODES)), max_size=3, unique=True).map(tuple),
    st.integers(0, 255).map(Status),
    numbers,
    st.integers(0, 10),
    st.integers(0, 40),
    st.integers(0, 40),
)
frames = st.builds(
    obd_records.FreezeFrame,
    st.sampled_from(KNOWN),
    numbers,
    st.dictionaries(st.text(), quantities, max_size=4),
)
tests = st.sampled_from(sorted(TESTS))
saved_stores = st.builds(
    Saved,
    st.lists(dtcs, max_size=10, unique_by=lambda dtc: dtc.code).map(tuple),
    st.lists(frames, max_size=4, unique_by=lambda frame: frame.code).map(tuple),
    st.dictionaries(st.sampled_from(KNOWN), names, max_size=4),
    st.lists(
        st.builds(obd_records.TestResult, tests, st.text(), quantities, quantities, quantities),
        max_size=5,
        unique_by=lambda r: (r.test, r.quantity),
    ).map(tuple),
    st.lists(
        st.builds(obd_records.Ratio, tests, numbers, numbers),
        max_size=5,
        unique_by=lambda r: r.test,
    ).map(tuple),
    st.builds(
        obd_records.Counts,
        numbers,
        numbers,
        numbers,
        quantities,
        quantities,
        quantities,
        quantities,
    ),
    st.frozensets(tests),
).map(lambda saved: replace(saved, latest_frames=saved.freeze_frames[1:]))


def reopened(path: Path) -> Saved:
    with closing(Memory(path)) as memory:
        return memory.load()


def times(saved: Saved) -> dict[str, int]:
    return {dtc.code: dtc.t_ns for dtc in saved.dtcs}


def sorted_out(saved: Saved) -> Saved:
    """Return what is saved in the order in which the file gives it."""
    return replace(
        saved,
        dtcs=tuple(sorted(saved.dtcs, key=lambda d: d.code)),
        results=tuple(sorted(saved.results, key=lambda r: (r.test, r.quantity))),
        ratios=tuple(sorted(saved.ratios, key=lambda r: r.test)),
    )


@inputs(60)
@given(saved=saved_stores, later=saved_stores)
def test_everything_is_loaded_as_it_was_saved(
    tmp_path_factory: pytest.TempPathFactory, saved: Saved, later: Saved
) -> None:
    path = tmp_path_factory.mktemp("memory") / "dtc.db"
    with closing(Memory(path)) as memory:
        for each in (saved, later, saved):
            memory.save(each)
            assert sorted_out(reopened(path)) == sorted_out(each)
            assert list(reopened(path).permanent) == list(each.permanent)  # oldest first


def test_a_code_matures_over_processes_as_it_does_in_one(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    for expected in ("pending", "confirmed"):
        with closing(Memory(path)) as memory:
            store = DtcStore(memory.load())
            store.start_driving_cycle()
            store.fail("slow_symmetric", 5)
            memory.save(store.saved)
        (stored,) = DtcStore(reopened(path)).active
        assert (stored.code, stored.fault, stored.state) == ("P0133", "slow_symmetric", expected)


def test_what_another_process_has_written_in_between_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory, closing(Memory(path)) as other:
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        other.save(Saved((Dtc("P0133", t_ns=2),), permanent={"P2195": "biased_lean"}))
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
    assert reopened(path) == Saved((Dtc("P0133", t_ns=1),))


def test_the_file_is_written_ahead_so_that_readers_never_hold_the_loop_up(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory, closing(sqlite3.connect(path)) as reader:
        assert reader.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        reader.execute("BEGIN")
        reader.execute("SELECT * FROM dtc").fetchall()
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
    assert times(reopened(path)) == {"P0133": 1}


def test_what_is_stored_already_is_not_written_again(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory, closing(sqlite3.connect(path)) as watcher:
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        before = watcher.execute("PRAGMA data_version").fetchone()
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        assert watcher.execute("PRAGMA data_version").fetchone() == before
        memory.save(Saved((Dtc("P0133", t_ns=2),)))
        assert watcher.execute("PRAGMA data_version").fetchone() != before


def test_a_new_memory_is_empty(tmp_path: Path) -> None:
    assert reopened(tmp_path / "dtc.db") == Saved()


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


OLD_TABLES = (
    "CREATE TABLE dtc (code TEXT PRIMARY KEY, fault TEXT NOT NULL, also TEXT NOT NULL,"
    " status INTEGER NOT NULL, t_ns INTEGER NOT NULL, failed_before INTEGER NOT NULL,"
    " passed_cycles INTEGER NOT NULL) STRICT",
    "CREATE TABLE reference (model_sha256 TEXT PRIMARY KEY, offset_low REAL NOT NULL,"
    " offset_high REAL NOT NULL, gain REAL NOT NULL, drives INTEGER NOT NULL) STRICT",
)


@pytest.mark.parametrize("version", [1, 2])
def test_a_memory_of_an_older_schema_is_brought_up_to_date(tmp_path: Path, version: int) -> None:
    # GIVEN a file as an older version wrote it: a code that was pending in an earlier drive
    path = tmp_path / "dtc.db"
    with closing(sqlite3.connect(path)) as db:
        for table in OLD_TABLES[:version]:
            db.execute(table)
        db.execute("INSERT INTO dtc VALUES ('P0133', 'transient', 'slow_symmetric', 100, 0, 1, 0)")
        if version == 2:
            db.execute("INSERT INTO reference VALUES ('sha', -0.01, 0.02, 0.97, 4)")
        db.execute(f"PRAGMA user_version={version}")
        db.commit()
    # WHEN it is opened
    with closing(Memory(path)) as memory:
        saved = memory.load()
        # THEN all of it is there
        old = Dtc("P0133", "transient", ("slow_symmetric",), Status(0x64), failed_cycles=1)
        assert saved == Saved((old,))
        assert memory.reference("sha").drives == (4 if version == 2 else 0)
        with closing(sqlite3.connect(path)) as db:
            assert db.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)
        # and the code is confirmed when it fails again
        store = DtcStore(saved)
        store.fail("transient", 7)
        memory.save(store.saved)
    assert DtcStore(reopened(path)).active[0].state == "confirmed"


def make_newer(path: Path) -> None:
    """Make a memory as a later version would."""
    Memory(path).close()
    head = ["head", SCHEMA_VERSION + 1, "memory", 7, "", "digest"]
    with closing(sqlite3.connect(path)) as db:
        db.execute("DELETE FROM head")
        db.execute(
            "INSERT INTO head VALUES (?, ?, ?, ?, ?, ?)", [*head[1:], checksum_of(json.dumps(head))]
        )
        db.execute(f"PRAGMA user_version={SCHEMA_VERSION + 1}")
        db.commit()


def test_another_schema_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    make_newer(path)
    with pytest.raises(
        RecordingError, match=rf"dtc\.db: .* schema {SCHEMA_VERSION + 1}, wanted {SCHEMA_VERSION}"
    ):
        Memory(path)


def test_an_unknown_code_in_the_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save(Saved((Dtc("P9999"),)))
        with pytest.raises(RecordingError, match=r"dtc\.db: unknown trouble code 'P9999'"):
            memory.load()


def test_a_folder_that_is_not_there_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere/dtc\.db"):
        Memory(tmp_path / "nowhere" / "dtc.db")


def test_a_save_that_fails_leaves_the_memory_as_it_was_and_usable(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        # GIVEN a save that breaks half way: the second row does not fit the table
        too_large = Dtc("P2195", t_ns=2**70)
        with pytest.raises(RecordingError, match=r"dtc\.db: cannot store"):
            memory.save(Saved((Dtc("P0133", t_ns=2), too_large)))
        assert times(memory.load()) == {"P0133": 1}
        # THEN the next one works
        memory.save(Saved((Dtc("P0133", t_ns=3),)))
    assert times(reopened(path)) == {"P0133": 3}


def test_one_process_at_a_time_holds_a_memory_and_others_may_read_it(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path, hold=True)) as memory:
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        with pytest.raises(RecordingError, match=r"dtc\.db: the fault memory is in use"):
            Memory(path, hold=True)
        assert times(reopened(path)) == {"P0133": 1}
    Memory(path, hold=True).close()
    # and what could not be opened is not held
    other = tmp_path / "drive.log"
    other.write_text("(1.0) can0 123#00\n" * 100)
    for _ in range(2):
        with pytest.raises(RecordingError, match="not a fault memory"):
            Memory(other, hold=True)
    with pytest.raises(RecordingError, match=r"nowhere/dtc\.db: cannot open the fault memory"):
        Memory(tmp_path / "nowhere" / "dtc.db", hold=True)


def test_a_memory_that_is_let_go_or_refused_is_held_by_nobody(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    memory = Memory(path, hold=True)
    n_open = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        with pytest.raises(RecordingError, match="in use"):
            Memory(path, hold=True)
    assert len(list(Path("/proc/self/fd").iterdir())) == n_open
    for _ in range(2):  # closed twice does no harm
        memory.close()
    make_newer(path)
    folder = tmp_path / "folder"
    folder.mkdir()
    for _ in range(2):  # the second one would find it held
        with pytest.raises(RecordingError, match="schema"):
            Memory(path, hold=True)
        with pytest.raises(RecordingError, match="cannot open the fault memory"):
            Memory(folder, hold=True)


def test_a_memory_that_is_closed_is_a_file_that_may_be_copied_and_its_spare(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    memory = Memory(path)
    memory.save(Saved((Dtc("P0133", t_ns=1),)))
    memory.close()
    assert {file.name for file in tmp_path.iterdir()} == {"dtc.db", "dtc.db-spare"}
    for t_ns in (1, 2):  # also what stood in it when it was closed
        with pytest.raises(RecordingError, match="cannot store"):
            memory.save(Saved((Dtc("P0133", t_ns=t_ns),)))


def test_a_memory_can_be_read_while_another_process_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory, closing(sqlite3.connect(path)) as writer:
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        writer.execute("BEGIN IMMEDIATE")
        assert times(reopened(path)) == {"P0133": 1}


def test_what_is_learned_of_a_vehicle_is_kept_for_each_model(tmp_path: Path) -> None:
    path, config = tmp_path / "dtc.db", shipped().bias
    seen = Seen(-0.02, 1.1)
    with closing(Memory(path)) as memory:
        memory.learn("one", None, config)  # a drive that shows nothing
        assert memory.reference("one") == Reference()
        memory.learn("one", seen, config)
        memory.learn("one", seen, config)
    with closing(Memory(path)) as memory:
        assert memory.reference("one") == Reference().learn(seen, config).learn(seen, config)
        assert memory.reference("one").drives == 2
        assert memory.reference("other") == Reference()


def test_a_file_that_is_held_up_by_another_process_does_not_stall_the_loop(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory, closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN IMMEDIATE")
        began_s = time.monotonic()
        with pytest.raises(RecordingError, match=r"dtc\.db: cannot store .* locked"):
            memory.save(Saved((Dtc("P0133", t_ns=1),)))
        assert time.monotonic() - began_s < 2.0  # SQLite's own patience is five seconds
        other.rollback()
        memory.save(Saved((Dtc("P0133", t_ns=2),)))
    assert times(reopened(path)) == {"P0133": 2}


def test_two_processes_may_make_the_same_memory_at_once(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    code = "import sys, pathlib, monitor.memory.store as m; m.Memory(pathlib.Path(sys.argv[1]))"
    makers = [
        subprocess.Popen([sys.executable, "-c", code, path], stderr=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    for maker in makers:
        _, complaint = maker.communicate(timeout=60)
        assert maker.returncode == 0, complaint
    assert reopened(path) == Saved()
