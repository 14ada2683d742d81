"""The fault memory on disk: what it has stored outlives the process, whatever ends it."""

import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.config import shipped
from monitor.base.errors import RecordingError
from monitor.memory import obd_records
from monitor.memory.block import Block
from monitor.memory.codes import CODES, TESTS
from monitor.memory.content import SCHEMA_VERSION, Content, text_of
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import Saved
from monitor.memory.reference import Reference, Seen
from monitor.memory.store import Memory
from tests.helpers.examples import inputs

codes = st.sampled_from(sorted({code for group in CODES.values() for code in group}))
faults, tests = st.sampled_from(["", *CODES]), st.sampled_from(sorted(TESTS))
numbers, counters = st.integers(0, 2**62), st.integers(0, 40)
quantities = st.floats(allow_nan=False, allow_infinity=False)
also, status = st.lists(faults, max_size=3).map(tuple), st.integers(0, 255).map(Status)
values = st.dictionaries(st.text(), quantities, max_size=4)


def several(kind: Any, key: Callable[[Any], object], *parts: Any) -> st.SearchStrategy[Any]:
    return st.lists(st.builds(kind, *parts), max_size=5, unique_by=key).map(tuple)


saved_stores = st.builds(
    Saved,
    several(Dtc, lambda dtc: dtc.code, codes, faults, also, status, numbers, *3 * [counters]),
    several(obd_records.FreezeFrame, lambda frame: frame.code, codes, numbers, values),
    st.dictionaries(codes, faults, max_size=4),
    several(
        obd_records.TestResult, lambda r: (r.test, r.quantity), tests, st.text(), *3 * [quantities]
    ),
    several(obd_records.Ratio, lambda ratio: ratio.test, tests, numbers, numbers),
    st.builds(obd_records.Counts, *3 * [numbers], *4 * [quantities]),
    st.frozensets(tests),
)


def reopened(path: Path) -> Saved:
    with closing(Memory(path)) as memory:
        return memory.load()


def times(path: Path) -> dict[str, int]:
    return {dtc.code: dtc.t_ns for dtc in reopened(path).dtcs}


def at(t_ns: int) -> Saved:
    return Saved((Dtc("P0133", t_ns=t_ns),))


@inputs(50)
@given(saved=saved_stores, later=saved_stores)
def test_everything_is_loaded_as_it_was_saved(
    tmp_path_factory: pytest.TempPathFactory, saved: Saved, later: Saved
) -> None:
    path = tmp_path_factory.mktemp("memory") / "dtc.db"
    with closing(Memory(path)) as memory:
        for each in (saved, later, saved):
            memory.save(each)
            assert reopened(path) == each
            assert list(reopened(path).permanent) == list(each.permanent)  # oldest first


def test_what_another_process_has_written_in_between_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory, closing(Memory(path)) as other:
        memory.save(at(1))
        other.save(replace(at(2), permanent={"P2195": "biased_lean"}))
        memory.save(at(1))
    assert reopened(path) == at(1)


def test_what_is_stored_already_is_not_written_again(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path, hold=True)) as memory:
        memory.save(at(1))
        before = [file.stat().st_ino for file in Block(path).files]
        memory.save(at(1))
        assert [file.stat().st_ino for file in Block(path).files] == before
        memory.save(at(2))
        assert times(path) == {"P0133": 2}


def test_of_processes_that_take_the_lock_one_holds_it_at_a_time(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from monitor.base.errors import RecordingError\n"
        "from monitor.memory.lock import Lock\n"
        "path, n = Path('o2.db'), 0\n"
        "while n < 300:\n"
        "    try:\n"
        "        with Lock(path, path).taken():\n"
        "            count = Path('count').read_text()\n"
        "            Path('count').write_text(str(int(count) + 1))\n"
        "            n += 1\n"
        "    except RecordingError:\n"
        "        pass\n"
    )
    (tmp_path / "count").write_text("0")
    others = [subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path) for _ in range(3)]
    assert [other.wait(60) for other in others] == [0, 0, 0]
    assert (tmp_path / "count").read_text() == "900"


def test_a_new_memory_is_empty_and_two_files(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    assert reopened(path) == Saved()
    assert {file.name for file in tmp_path.iterdir()} == {"dtc.db", "dtc.db.b"}
    path.chmod(0o600)
    with closing(Memory(path)) as memory:
        memory.save(at(1))
    assert path.stat().st_mode & 0o777 == 0o600


def test_what_is_no_fault_memory_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    log, database = tmp_path / "drive.log", tmp_path / "notes.db"
    log.write_text("(1.0) can0 123#00\n" * 100)
    with closing(sqlite3.connect(database)) as db:
        db.execute("CREATE TABLE dtc (text TEXT)")
        db.commit()
    for path in (log, database):
        before = path.read_bytes()
        for hold in (False, True, True):  # what was refused is not held
            with pytest.raises(RecordingError, match=rf"{path.name}: not a fault memory"):
                Memory(path, hold=hold)
        assert path.read_bytes() == before


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, wanted = tmp_path / "dtc.db", SCHEMA_VERSION
    newer = text_of(Content()).replace(f'"schema": {wanted}', f'"schema": {wanted + 1}')
    for text, what in ((newer, f"schema {wanted + 1}, wanted {wanted}"), ("{}", "schema")):
        monkeypatch.setattr("monitor.memory.block.text_of", lambda _, text=text: text)
        Block(path).write(Content())
        for _ in range(2):
            with pytest.raises(RecordingError, match=rf"dtc\.db: .* another version: .*{what}"):
                Memory(path, hold=True)


def test_an_unknown_code_in_the_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path)) as memory:
        memory.save(Saved((Dtc("P9999"),)))
        with pytest.raises(RecordingError, match=r"dtc\.db: unknown trouble code 'P9999'"):
            memory.load()


def test_a_place_where_no_memory_can_be_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "nowhere/dtc.db", tmp_path / "folder", Path(), Path("/")):
        with pytest.raises(RecordingError, match=f"{path}: cannot open the fault memory"):
            Memory(path, hold=True)


def test_one_process_at_a_time_holds_a_memory_and_others_may_read_it(tmp_path: Path) -> None:
    path = tmp_path / "dtc.db"
    with closing(Memory(path, hold=True)) as memory:
        memory.save(at(1))
        n_open = len(list(Path("/proc/self/fd").iterdir()))
        for _ in range(5):
            with pytest.raises(RecordingError, match=r"dtc\.db: the fault memory is in use"):
                Memory(path, hold=True)
        assert len(list(Path("/proc/self/fd").iterdir())) == n_open
        with closing(Memory(path)) as other:
            assert other.load() == at(1)
            with pytest.raises(RecordingError, match=r"dtc\.db: the fault memory is in use"):
                other.save(at(2))
        assert times(path) == {"P0133": 1}
    for _ in range(2):  # closed twice does no harm
        memory.close()
    with pytest.raises(RecordingError, match="cannot store the fault memory: it is closed"):
        memory.save(at(1))
    Memory(path, hold=True).close()


def test_another_name_of_a_memory_is_the_same_memory(tmp_path: Path) -> None:
    path, link = tmp_path / "o2.db", tmp_path / "link.db"
    link.symlink_to(path)
    with closing(Memory(link, hold=True)) as memory:  # also before there is a file
        memory.save(at(1))
        for name in (path, link):
            with pytest.raises(RecordingError, match=rf"{name.name}: .* is in use"):
                Memory(name, hold=True)
        assert memory.condition.entry == {"state": "ok", "set_aside": None}
    assert link.is_symlink()
    assert times(path) == times(link) == {"P0133": 1}


def test_a_copy_of_the_file_is_the_memory_also_beside_another_s_partner(tmp_path: Path) -> None:
    old, new = tmp_path / "old.db", tmp_path / "new.db"
    for path, n in ((old, 1), (new, 5)):
        with closing(Memory(path)) as memory:
            for t_ns in range(n):
                memory.save(at(t_ns))
    new.write_bytes(old.read_bytes())
    for path in (new, tmp_path / "alone.db"):
        path.write_bytes(old.read_bytes())
        with closing(Memory(path, hold=True)) as memory:
            assert memory.condition.state == "ok"
            assert memory.load() == at(0)
            memory.save(at(7))
        assert times(path) == {"P0133": 7}


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
