"""The fault memory on disk: trouble codes, counts and the vehicle's healthy reference.

A memory is a main file (SQLite) and a spare copy (text), each with checksums. When ``save``
returns, the data survives a kill, and damage of one of both; see ``agreement`` and ``repair``.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from monitor.base.config import BiasConfig, ProfileConfig
from monitor.base.errors import RecordingError
from monitor.memory import repair, spare
from monitor.memory.agreement import Condition, agreed
from monitor.memory.codes import CODES, LOST, is_known
from monitor.memory.content import SCHEMA_VERSION, Content, reference_row, rows_of, saved_of
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.lock import Lock
from monitor.memory.reference import Reference, Seen
from monitor.memory.tables import ERRORS, DamagedError, Tables

__all__ = ["SCHEMA_VERSION", "Condition", "Memory"]


class Memory:
    """Stores the fault memory in files that are made if they do not exist.

    hold : lock the memory against other processes that hold it, until ``close``
    Raises RecordingError if the file is no fault memory, has a newer schema, or is held by another
    process. Damage is no error: ``condition`` says what opening found.
    """

    def __init__(self, path: Path, *, hold: bool = False) -> None:
        self._path, self._spare = path, spare.spare_of(path)
        self._lock = Lock(path)
        self._tables: Tables | None = None
        self._data_version = -1  # SQLite's; it stays equal until another process writes the file
        if hold:
            self._lock.take()
        try:
            self._content = self._opened()
        except BaseException:
            self.close()
            raise

    def _opened(self) -> Content:
        """Open main file and spare copy, repair them, and return their content."""
        try:
            self._tables, content, self.condition = agreed(self._path)
        except DamagedError as damage:
            self._tables, content, self.condition = repair.repaired(self._path, self._lock, damage)
        self._mark()
        self._lock.note(content.memory, content.generation)
        if content.set_aside:  # also if a kill came before the loss was a stored code
            aside = self._path.with_name(content.set_aside)
            self.condition = Condition.lost(self._path, aside)
        return content

    def _mark(self) -> None:
        """Note that the content in RAM is the one in the file."""
        self._data_version = self._tables.data_version if self._tables else -1

    def load(self) -> Saved:
        """Return the stored content.

        Raises RecordingError if the file cannot be read or holds unknown codes or values.
        """
        rows = self._settled().rows
        for code in (row[0] for row in rows["dtc"]):
            if not is_known(code):
                raise RecordingError(f"{self._path}: unknown trouble code {code!r}")
        try:
            return saved_of(rows)
        except (ValueError, TypeError) as error:
            raise RecordingError(f"{self._path}: damaged fault memory: {error}") from None

    def begin(self, profile: ProfileConfig) -> DtcStore:
        """Return the fault memory in RAM, with a driving cycle begun.

        Raises RecordingError as ``load``.
        """
        store = DtcStore(self.load(), profile)
        store.is_lost = bool(self._content.set_aside)
        store.start_driving_cycle()
        return store

    def _settled(self) -> Content:
        """Return the content of the file, repaired if it was damaged meanwhile."""
        try:
            return self._current()
        except DamagedError as damage:
            self._repair(damage)
        return self._content

    def _current(self) -> Content:
        """Return the content of the file; it is in RAM unless another process has written."""
        if self._tables is None or self._tables.data_version == self._data_version:
            return self._content
        content = self._tables.read().content
        if content is None:
            raise DamagedError("what another process stored is damaged")
        return content

    def reference(self, model_sha256: str) -> Reference:
        """Return the vehicle's reference for a model; an empty one if there is none.

        Raises RecordingError if the file cannot be read.
        """
        return self._settled().reference(model_sha256)

    def learn(self, model_sha256: str, seen: Seen | None, config: BiasConfig) -> None:
        """Add a healthy drive to the vehicle's reference for a model; None adds nothing.

        Raises RecordingError if the file cannot be read or written.
        """
        if seen is None:
            return

        def learned(content: Content) -> Content:
            new = content.reference(model_sha256).learn(seen, config)
            others = [row for row in content.rows["reference"] if row[0] != model_sha256]
            return content.after({"reference": [*others, reference_row(model_sha256, new)]})

        self._store(learned)

    def save(self, saved: Saved) -> None:
        """Store the tables that changed, in one transaction.

        Changes that another process made meanwhile are replaced. Raises RecordingError if the
        files cannot be written; they then hold the content before, or the spare copy the new one.
        """
        rows = rows_of(saved)
        is_told = any(code in CODES[LOST] and fault for code, fault, *_ in rows["dtc"])

        def changed(content: Content) -> Content:
            differ = {table: new for table, new in rows.items() if new != content.rows[table]}
            told = is_told and content.set_aside
            if not differ and not told:
                return content
            after = content.after(differ)
            return replace(after, set_aside="") if told else after

        self._store(changed)

    def forget_loss(self) -> None:
        """Store that the user knows of the lost memory before this one."""

        def told(content: Content) -> Content:
            return replace(content.after({}), set_aside="") if content.set_aside else content

        self._store(told)

    def _store(self, change: Callable[[Content], Content]) -> None:
        """Store a change; repair the main file first if it was damaged meanwhile."""
        try:
            self._write(change)
        except DamagedError as damage:
            self._repair(damage)
            self._write(change)

    def _repair(self, damage: DamagedError) -> None:
        """Open the files anew; raises RecordingError if that is another process's business."""
        if not self._lock.is_taken:
            raise RecordingError(f"{self._path}: the fault memory was damaged: {damage}") from None
        self._close_tables()
        self._content = self._opened()

    def _write(self, change: Callable[[Content], Content]) -> None:
        if self._is_as_left and change(self._content) == self._content:
            return
        with self._writing() as tables:
            before = self._current()
            new = change(before)
            if new != before:
                tables.write(new, [t for t in new.rows if new.rows[t] != before.rows[t]])
                spare.write(self._spare, new)
            self._mark()
        self._content = new
        self._lock.note(new.memory, new.generation)

    @property
    def _is_as_left(self) -> bool:
        return self._tables is not None and self._tables.data_version == self._data_version

    @contextmanager
    def _writing(self) -> Iterator[Tables]:
        """Commit or roll back together; raises RecordingError, or DamagedError."""
        what = f"{self._path}: cannot store the fault memory"
        if self._tables is None:
            raise RecordingError(f"{what}: it is closed, or in use by a running monitor")
        try:
            with self._tables.transaction():
                yield self._tables
        except ERRORS as error:
            self._data_version = -1
            raise self._tables.meaning_of_writing(error) from None
        except OverflowError as error:
            self._data_version = -1
            raise RecordingError(f"{what}: {error}") from None
        except OSError as error:
            self._data_version = -1
            raise RecordingError(f"{what}: {self._spare.name}: {error.strerror}") from None

    def close(self) -> None:
        """Close the files and release the lock."""
        self._close_tables()
        self._lock.let_go()

    def _close_tables(self) -> None:
        if self._tables is not None:
            self._tables.close()
            self._tables = None
