"""The main file of a fault memory: tables of SQLite in WAL mode with full synchronisation.

SQLite finds damage of its own structure only where it reads, and none in the values. So every row
has a checksum, and what is read counts only if its checksums are right.
"""

import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import RecordingError
from monitor.memory.content import SCHEMA_VERSION, TABLES, Content, Copy, Head, Row
from monitor.memory.content import checksum as checksum_of_row
from monitor.memory.schema import SIGNATURES, STEPS
from monitor.memory.spare import spare_of

BUSY_MS: Final = 250  # longest wait for another process; the live loop waits as long
MAGIC: Final = b"SQLite format 3\0"
HEADER_FIXED: Final = {18: b"\x01\x02", 19: b"\x01\x02", 20: b"\0", 21: b"@", 22: b" ", 23: b" "}
LOOKED_AT: Final = 1_000_000  # bytes in which the signatures of a memory are looked for
BESIDE: Final = ("-wal", "-shm", "-journal")  # files that SQLite makes
# Messages of SQLite hold texts of the file, which need not be text.
ERRORS: Final = (sqlite3.Error, MemoryError, UnicodeDecodeError)
_FILE_ERRORS: Final = (
    *("SQLITE_READONLY", "SQLITE_FULL", "SQLITE_IOERR", "SQLITE_CANTOPEN", "SQLITE_BUSY"),
    *("SQLITE_LOCKED", "SQLITE_NOMEM", "SQLITE_PERM"),
)
_DAMAGE: Final = (
    "SQLITE_CORRUPT",
    "SQLITE_NOTADB",
    "SQLITE_ERROR",
    "SQLITE_READONLY",
)  # if written
_HEAD: Final = "head"


class DamagedError(Exception):
    """The main file is damaged, or a part of it."""


class Tables:
    """An open main file; a file that is not there is made.

    Raises RecordingError if the file cannot be opened, belongs to another program or has a newer
    schema, DamagedError if it is a damaged fault memory.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        _check_header(path)
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
        except sqlite3.Error as error:
            raise RecordingError(f"{path}: cannot open the fault memory: {error}") from None
        try:
            self._db.execute(f"PRAGMA busy_timeout={BUSY_MS}")
            self._db.execute("PRAGMA synchronous=FULL")
            self._migrate()
            self._db.execute("PRAGMA journal_mode=WAL")
        except ERRORS as error:
            self.close()
            raise self._meaning(error, "open") from None
        except (RecordingError, DamagedError):
            self.close()
            raise

    def _migrate(self) -> None:
        """Bring the tables up to date; a database of another program stays unchanged."""
        if self.number("PRAGMA user_version") == SCHEMA_VERSION:
            return
        head = self._head()
        if head is not None:
            if head.schema == SCHEMA_VERSION:
                raise DamagedError("the number of the schema is wrong")
            raise RecordingError(
                f"{self._path}: fault memory of schema {head.schema}, wanted {SCHEMA_VERSION}"
            )
        with self.transaction():  # another process may have created the tables meanwhile
            version = self.number("PRAGMA user_version")
            if version == SCHEMA_VERSION:
                return
            if version == 0 and self.number("SELECT count(*) FROM sqlite_master"):
                if not _is_ours(self._path):
                    raise RecordingError(
                        f"{self._path}: not a fault memory: the database belongs to another program"
                    )
                raise DamagedError("the number of the schema is wrong")
            if version > SCHEMA_VERSION:
                raise DamagedError("the number of the schema is wrong")
            for statements in STEPS[version:]:
                for statement in statements:
                    self._db.execute(statement)
            old = {table: [row[:-1] for row in self._rows(table)] for table in TABLES}
            self.write(Content(old, generation=1), TABLES)
            self._db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")

    def number(self, query: str) -> int:
        """Return the number that a query gives; raises sqlite3.Error."""
        with closing(self._db.execute(query)) as rows:
            return int(rows.fetchone()[0])

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit the statements together, or roll them all back; raises sqlite3.Error."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")

    @property
    def data_version(self) -> int:
        """Return a number that stays equal until another process writes the file, -1 if unknown."""
        try:
            return self.number("PRAGMA data_version")
        except ERRORS:
            return -1

    def read(self) -> Copy:
        """Return all that is good in the file; raises RecordingError if it cannot be read."""
        head: Head | None = None
        rows, notes = set[tuple[str, Row]](), list[str]()
        with self._snapshot():
            try:
                head = self._head()
            except ERRORS as error:
                notes.append(self._damage(error))
            for table in TABLES:
                try:
                    for *fields, checksum in self._rows(table):
                        if _fits(table, fields, checksum):
                            rows.add((table, tuple(fields)))
                        else:
                            notes.append(f"a row of {table} has changed")
                except ERRORS as error:
                    notes.append(self._damage(error))
        return Copy(
            head, frozenset(rows), f"of the main file {notes[0] if notes else 'rows are gone'}"
        )

    @contextmanager
    def _snapshot(self) -> Iterator[None]:
        """Read all tables as one storing left them."""
        is_own = not self._db.in_transaction
        try:
            if is_own:
                self._db.execute("BEGIN")
            yield
        finally:
            if is_own and self._db.in_transaction:
                self._db.execute("ROLLBACK")

    def check(self) -> None:
        """Raise DamagedError if the structure of the file is wrong where no row is read."""
        try:
            with closing(self._db.execute("PRAGMA integrity_check(1)")) as found:
                ((said,),) = found.fetchall()
        except ERRORS as error:
            said = self._damage(error)
        if said != "ok":
            raise DamagedError(said.splitlines()[-1])

    def _rows(self, table: str) -> list[Row]:
        with closing(self._db.execute(f"SELECT * FROM {table}")) as rows:
            return rows.fetchall()

    def _head(self) -> Head | None:
        """Return the head if its checksum is right, None if there is none."""
        if not self.number("SELECT count(*) FROM sqlite_master WHERE name='head'"):
            return None
        for *fields, checksum in self._rows(_HEAD):
            if _fits(_HEAD, fields, checksum) and len(fields) == len(Head._fields):
                return Head(*fields)
        return None

    def write(self, content: Content, tables: Iterable[str]) -> None:
        """Replace rows and head, inside a transaction; raises sqlite3.Error or OverflowError."""
        for table in tables:
            self._replace(table, content.rows[table])
        self._replace(_HEAD, [content.head])

    def _replace(self, table: str, rows: Iterable[Row]) -> None:
        self._db.execute(f"DELETE FROM {table}")
        for row in rows:
            whole = (*row, checksum_of_row(table, row))
            self._db.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(whole))})", whole)

    def _damage(self, error: Exception) -> str:
        """Return the note of a damage; raises RecordingError if the error is another one."""
        meaning = self._meaning(error, "read")
        if isinstance(meaning, RecordingError):
            raise meaning from None
        return str(meaning)

    def meaning_of_writing(self, error: Exception) -> RecordingError | DamagedError:
        """Return the meaning of an error of writing: damage, or a disk, process or value."""
        name = getattr(error, "sqlite_errorname", "")
        if name.startswith(_DAMAGE) or isinstance(error, UnicodeDecodeError):
            return self._meaning(error, "store")
        return RecordingError(f"{self._path}: cannot store the fault memory: {error}")

    def _meaning(self, error: Exception, what: str) -> RecordingError | DamagedError:
        """Return the meaning of an error of SQLite: the disk or another process, or damage."""
        name = getattr(error, "sqlite_errorname", "")
        may_write = os.access(self._path, os.W_OK) and os.access(self._path.parent, os.W_OK)
        if name.startswith(_FILE_ERRORS) and not (name == "SQLITE_READONLY" and may_write):
            return RecordingError(f"{self._path}: cannot {what} the fault memory: {error}")
        return DamagedError(str(error))

    def close(self) -> None:
        """Close the file."""
        self._db.close()


def _fits(table: str, fields: list[Any], checksum: Any) -> bool:
    """Return whether a row is as it was written; a damaged value may have any type."""
    try:
        return bool(checksum_of_row(table, fields) == checksum)
    except (TypeError, ValueError):
        return False


def _check_header(path: Path) -> None:
    """Raise RecordingError if a file is another one, DamagedError if its first bytes are wrong.

    SQLite writes nothing into a file whose bytes 18 to 23 it does not know, without saying why.
    """
    try:
        with path.open("rb") as file:
            begin = file.read(len(MAGIC) + 8)
    except OSError:
        return  # SQLite says it better
    if not begin:
        return
    if not begin.startswith(MAGIC):
        if MAGIC.startswith(begin) or _is_ours(path):
            raise DamagedError("the beginning of the file is wrong")
        raise RecordingError(f"{path}: not a fault memory")
    wrong = [at for at, known in HEADER_FIXED.items() if begin[at : at + 1] not in _singly(known)]
    if wrong:
        raise DamagedError("the header of the file is wrong")


def _singly(known: bytes) -> list[bytes]:
    return [bytes([each]) for each in known]


def _is_ours(path: Path) -> bool:
    """Return whether a file was a fault memory, by its texts or its spare copy."""
    if spare_of(path).exists():
        return True
    with path.open("rb") as file:
        begin = file.read(LOOKED_AT)
    return any(text in begin for text in SIGNATURES)


def is_empty(path: Path) -> bool:
    """Return whether a main file is not there, or holds nothing."""
    return not path.exists() or (path.is_file() and path.stat().st_size == 0)


def make(path: Path, content: Content) -> None:
    """Write a new main file in one step; raises RecordingError.

    A damaged file before it is replaced, with the files that SQLite made beside it.
    """
    begun = path.with_name(path.name + "-begun")
    try:
        remove(begun)
        with closing(Tables(begun)) as tables, tables.transaction():
            tables.write(content, TABLES)
        remove_beside(path)
        begun.replace(path)
    except (OSError, DamagedError, *ERRORS) as error:
        raise RecordingError(f"{path}: cannot store the fault memory: {error}") from None


def remove(path: Path) -> None:
    """Remove a main file and the files beside it; raises OSError."""
    remove_beside(path)
    path.unlink(missing_ok=True)


def remove_beside(path: Path) -> None:
    """Remove the files that SQLite made beside a main file; raises OSError."""
    for suffix in BESIDE:
        path.with_name(path.name + suffix).unlink(missing_ok=True)
