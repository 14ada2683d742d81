"""The fault memory on disk: trouble codes, counts and the vehicle's healthy reference.

SQLite in WAL mode with full synchronisation: when ``save`` returns, the data survives a kill.
"""

import fcntl
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any, Final

from monitor.base.config import BiasConfig
from monitor.base.errors import RecordingError
from monitor.memory.dtc import CODES, Dtc, Saved, Status
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult
from monitor.memory.reference import Reference, Seen

SCHEMA_VERSION = 3
BUSY_MS: Final = 250  # longest wait for another process; the live loop waits as long
# Statements that turn a file of version n - 1 into one of version n.
_STEPS = (
    (
        """
CREATE TABLE dtc (
    code TEXT PRIMARY KEY,
    fault TEXT NOT NULL,
    also TEXT NOT NULL,
    status INTEGER NOT NULL,
    t_ns INTEGER NOT NULL,
    failed_before INTEGER NOT NULL,
    passed_cycles INTEGER NOT NULL
) STRICT
""",
    ),
    (
        """
CREATE TABLE reference (
    model_sha256 TEXT PRIMARY KEY,
    offset_low REAL NOT NULL,
    offset_high REAL NOT NULL,
    gain REAL NOT NULL,
    drives INTEGER NOT NULL
) STRICT
""",
    ),
    (
        "ALTER TABLE dtc RENAME COLUMN failed_before TO failed_cycles",
        "ALTER TABLE dtc ADD COLUMN warm_ups INTEGER NOT NULL DEFAULT 0",
        """
CREATE TABLE freeze_frame (
    place INTEGER NOT NULL,
    code TEXT PRIMARY KEY,
    t_ns INTEGER NOT NULL,
    signals TEXT NOT NULL
) STRICT
""",
        """
CREATE TABLE permanent (
    place INTEGER NOT NULL,
    code TEXT PRIMARY KEY,
    fault TEXT NOT NULL
) STRICT
""",
        """
CREATE TABLE result (
    test TEXT NOT NULL,
    quantity TEXT NOT NULL,
    value REAL NOT NULL,
    low REAL NOT NULL,
    high REAL NOT NULL,
    PRIMARY KEY (test, quantity)
) STRICT
""",
        """
CREATE TABLE ratio (
    test TEXT PRIMARY KEY,
    numerator INTEGER NOT NULL,
    denominator INTEGER NOT NULL
) STRICT
""",
        "CREATE TABLE counted (name TEXT PRIMARY KEY, number ANY NOT NULL) STRICT",
        "CREATE TABLE completed (test TEXT PRIMARY KEY) STRICT",
    ),
)
# Rows by table; all rows of a table are replaced together.
Rows = dict[str, list[tuple[Any, ...]]]
_ORDER: Final = {"freeze_frame": "place", "permanent": "place"}


class Memory:
    """Stores the fault memory in an SQLite file, which is created if it does not exist.

    hold : lock the file against other processes that hold it, until ``close``
    Raises RecordingError if the file is no fault memory, has another schema version, or is held
    by another process.
    """

    def __init__(self, path: Path, *, hold: bool = False) -> None:
        self._path = path
        self._hold = _hold(path) if hold else None
        self._stored: Rows = {}  # rows in the file as of the last save
        self._data_version = -1  # SQLite's; it stays equal until another process writes the file
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
        except sqlite3.Error as error:
            self._let_go()
            raise RecordingError(f"{path}: cannot open the fault memory: {error}") from None
        try:
            self._db.execute("PRAGMA synchronous=FULL")
            self._migrate()
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute(f"PRAGMA busy_timeout={BUSY_MS}")
        except sqlite3.Error as error:
            self.close()
            raise RecordingError(f"{path}: {_what(error)}: {error}") from None
        except RecordingError:
            self.close()
            raise

    def _migrate(self) -> None:
        """Bring the tables up to date; a database of another program stays unchanged."""
        if self._number("PRAGMA user_version") < SCHEMA_VERSION:
            with self._transaction():  # another process may have created the tables meanwhile
                version = self._number("PRAGMA user_version")
                if version == 0 and self._number("SELECT count(*) FROM sqlite_master"):
                    raise sqlite3.DatabaseError("the database belongs to another program")
                for statements in _STEPS[version:]:
                    for statement in statements:
                        self._db.execute(statement)
                self._db.execute(f"PRAGMA user_version={max(version, SCHEMA_VERSION)}")
        version = self._number("PRAGMA user_version")
        if version != SCHEMA_VERSION:
            raise RecordingError(
                f"{self._path}: fault memory of schema {version}, wanted {SCHEMA_VERSION}"
            )

    def _number(self, query: str) -> int:
        with closing(self._db.execute(query)) as rows:
            return int(rows.fetchone()[0])

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """Commit the statements together, or roll them all back."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")

    def load(self) -> Saved:
        """Return the stored content.

        Raises RecordingError if the file cannot be read or holds unknown codes or values.
        """
        try:
            rows = {table: self._read(table) for table in _rows_of(Saved())}
        except sqlite3.Error as error:
            raise RecordingError(f"{self._path}: cannot read the fault memory: {error}") from None
        codes = {code for group in CODES.values() for code in group}
        for code in (row[0] for row in rows["dtc"]):
            if code not in codes:
                raise RecordingError(f"{self._path}: unknown trouble code {code!r}")
        try:
            return _saved_of(rows)
        except (ValueError, TypeError) as error:
            raise RecordingError(f"{self._path}: damaged fault memory: {error}") from None

    def _read(self, table: str) -> list[tuple[Any, ...]]:
        return self._db.execute(f"SELECT * FROM {table} ORDER BY {_ORDER.get(table, 1)}").fetchall()

    def reference(self, model_sha256: str) -> Reference:
        """Return the vehicle's reference for a model; an empty one if there is none.

        Raises RecordingError if the file cannot be read.
        """
        try:
            row = self._db.execute(
                "SELECT offset_low, offset_high, gain, drives FROM reference WHERE model_sha256=?",
                (model_sha256,),
            ).fetchone()
        except sqlite3.Error as error:
            raise RecordingError(f"{self._path}: cannot read the fault memory: {error}") from None
        return Reference(*row) if row else Reference()

    def learn(self, model_sha256: str, seen: Seen | None, config: BiasConfig) -> None:
        """Add a healthy drive to the vehicle's reference for a model; None adds nothing.

        Raises RecordingError if the file cannot be read or written.
        """
        if seen is None:
            return
        row = (model_sha256, *astuple(self.reference(model_sha256).learn(seen, config)))
        with self._writing():
            self._db.execute("INSERT OR REPLACE INTO reference VALUES (?, ?, ?, ?, ?)", row)

    def save(self, saved: Saved) -> None:
        """Store the tables that changed, in one transaction.

        Changes that another process made meanwhile are replaced. Raises RecordingError if the file
        cannot be written; its content then stays unchanged.
        file cannot be written; it then holds what it held before.
        """
        rows = _rows_of(saved)
        if self._is_as_left and rows == self._stored:
            return
        with self._writing():
            stored = self._stored if self._is_as_left else {}
            for table, new in rows.items():
                if new != stored.get(table):
                    self._replace(table, new)
        self._stored = rows

    @property
    def _is_as_left(self) -> bool:
        """Return whether no other process has written since; a transaction keeps it so."""
        try:
            return self._data_version == self._number("PRAGMA data_version")
        except sqlite3.Error:  # the write that follows reports the error
            return False

    def _replace(self, table: str, rows: Iterable[tuple[Any, ...]]) -> None:
        self._db.execute(f"DELETE FROM {table}")
        for row in rows:
            self._db.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", row)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Commit or roll back together; raises RecordingError on failure."""
        try:
            with self._transaction():
                yield
                self._data_version = self._number("PRAGMA data_version")
        except (sqlite3.Error, OverflowError) as error:
            self._data_version = -1
            raise RecordingError(f"{self._path}: cannot store the fault memory: {error}") from None

    def close(self) -> None:
        """Close the file and release its lock."""
        self._db.close()
        self._let_go()

    def _let_go(self) -> None:
        if self._hold is not None:
            os.close(self._hold)
            self._hold = None


def _what(error: sqlite3.Error) -> str:
    """Return the meaning of an error at opening: a file problem, or the wrong kind of file."""
    file_errors = (
        "SQLITE_READONLY",
        "SQLITE_FULL",
        "SQLITE_IOERR",
        "SQLITE_CANTOPEN",
        "SQLITE_BUSY",
    )
    if getattr(error, "sqlite_errorname", "").startswith(file_errors):
        return "cannot open the fault memory"
    return "not a fault memory"


def _hold(path: Path) -> int:
    """Lock a file beside the memory; return its descriptor.

    SQLite's locks do not serve: they end when any descriptor of the database is closed.
    """
    beside = path.with_name(f"{path.name}-lock")
    try:
        descriptor = os.open(beside, os.O_CREAT | os.O_RDWR, 0o644)
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot open the fault memory: {beside.name}: {error.strerror}"
        ) from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise RecordingError(f"{path}: the fault memory is in use by a running monitor") from None
    return descriptor


def _rows_of(saved: Saved) -> Rows:
    """Return the rows of every table, in the order of its columns."""
    return {
        "dtc": [
            (
                d.code,
                d.fault,
                ",".join(d.also),
                int(d.status),
                d.t_ns,
                d.failed_cycles,
                d.passed_cycles,
                d.warm_ups,
            )
            for d in saved.dtcs
        ],
        "freeze_frame": [
            (place, f.code, f.t_ns, json.dumps(dict(f.values)))
            for place, f in enumerate(saved.freeze_frames)
        ],
        "permanent": [(i, code, fault) for i, (code, fault) in enumerate(saved.permanent.items())],
        "result": [astuple(result) for result in saved.results],
        "ratio": [astuple(ratio) for ratio in saved.ratios],
        "counted": list(asdict(saved.counts).items()),
        "completed": [(test,) for test in sorted(saved.completed)],
    }


def _saved_of(rows: Mapping[str, list[tuple[Any, ...]]]) -> Saved:
    """Return the content of the tables' rows; raises ValueError or TypeError if damaged."""
    dtcs = []
    for code, fault, also, status, t_ns, failed, passed, warm_ups in rows["dtc"]:
        names = tuple(name for name in also.split(",") if name)
        dtcs.append(Dtc(code, fault, names, Status(status), t_ns, failed, passed, warm_ups))
    return Saved(
        tuple(dtcs),
        tuple(FreezeFrame(code, t_ns, json.loads(s)) for _, code, t_ns, s in rows["freeze_frame"]),
        {code: fault for _, code, fault in rows["permanent"]},
        tuple(TestResult(*row) for row in rows["result"]),
        tuple(Ratio(*row) for row in rows["ratio"]),
        Counts(**dict(rows["counted"])),
        frozenset(test for (test,) in rows["completed"]),
    )
