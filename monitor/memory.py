"""The fault memory on disk: trouble codes and the vehicle's reference, which outlive the process.

SQLite in WAL mode with full synchronisation: what ``save`` has returned from survives a kill.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple
from pathlib import Path

from monitor.config import BiasConfig
from monitor.dtc import CODES, Dtc, Status
from monitor.errors import RecordingError
from monitor.reference import Reference, Seen

SCHEMA_VERSION = 2
# what makes a file of version n out of one of version n - 1
_STEPS = (
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
    """
CREATE TABLE reference (
    model_sha256 TEXT PRIMARY KEY,
    offset_low REAL NOT NULL,
    offset_high REAL NOT NULL,
    gain REAL NOT NULL,
    drives INTEGER NOT NULL
) STRICT
""",
)


class Memory:
    """Stores trouble codes in an SQLite file, made when it does not exist.

    Raises RecordingError if the file is no fault memory or of another schema version.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
        except sqlite3.Error as error:
            raise RecordingError(f"{path}: cannot open the fault memory: {error}") from None
        try:
            self._db.execute("PRAGMA synchronous=FULL")
            self._migrate()
            self._db.execute("PRAGMA journal_mode=WAL")
        except sqlite3.Error as error:
            self._db.close()
            raise RecordingError(f"{path}: not a fault memory: {error}") from None
        except RecordingError:
            self._db.close()
            raise

    def _migrate(self) -> None:
        """Bring the tables up to date; a file of anyone else is left as it is."""
        if self._number("PRAGMA user_version") < SCHEMA_VERSION:
            with self._transaction():  # another process may have made the tables by now
                version = self._number("PRAGMA user_version")
                if version == 0 and self._number("SELECT count(*) FROM sqlite_master"):
                    raise sqlite3.DatabaseError("the database belongs to another program")
                for step in _STEPS[version:]:
                    self._db.execute(step)
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
        """Write all or nothing."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")

    def load(self) -> tuple[Dtc, ...]:
        """Return the stored codes.

        Raises RecordingError if the file cannot be read or holds a code that is not known.
        """
        found = []
        known = {code for group in CODES.values() for code in group}
        try:
            rows = self._db.execute(
                "SELECT code, fault, also, status, t_ns, failed_before, passed_cycles FROM dtc"
            ).fetchall()
        except sqlite3.Error as error:
            raise RecordingError(f"{self._path}: cannot read the fault memory: {error}") from None
        for code, fault, also, status, t_ns, before, passed in rows:
            if code not in known:
                raise RecordingError(f"{self._path}: unknown trouble code {code!r}")
            names = tuple(name for name in also.split(",") if name)
            found.append(Dtc(code, fault, names, Status(status), t_ns, bool(before), passed))
        return tuple(found)

    def reference(self, model_sha256: str) -> Reference:
        """Return what was learned of the vehicle with that model, an empty one if nothing.

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
        """Store what a drive shows of the vehicle, beside what is known with that model.

        Raises RecordingError if the file cannot be read or written.
        """
        if seen is None:
            return
        row = (model_sha256, *astuple(self.reference(model_sha256).learn(seen, config)))
        self._write("INSERT OR REPLACE INTO reference VALUES (?, ?, ?, ?, ?)", [row])

    def save(self, dtcs: Iterable[Dtc]) -> None:
        """Store codes in one transaction.

        Raises RecordingError if the file cannot be written.
        """
        rows = [
            (d.code, d.fault, ",".join(d.also), int(d.status), d.t_ns, d.failed_before,
             d.passed_cycles)
            for d in dtcs
        ]  # fmt: skip
        self._write("INSERT OR REPLACE INTO dtc VALUES (?, ?, ?, ?, ?, ?, ?)", rows)

    def _write(self, command: str, rows: Sequence[tuple[object, ...]]) -> None:
        try:
            with self._transaction():
                self._db.executemany(command, rows)
        except sqlite3.Error as error:
            raise RecordingError(f"{self._path}: cannot store the fault memory: {error}") from None

    def close(self) -> None:
        """Close the file."""
        self._db.close()
