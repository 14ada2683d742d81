"""The fault memory on disk: trouble codes, counts and the vehicle's healthy reference.

When ``save`` returns, the data survive a kill, and damage of one of the two files, see ``block``.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from monitor.base.config import BiasConfig, ProfileConfig
from monitor.base.errors import RecordingError
from monitor.memory.block import Block, StoredContent
from monitor.memory.codes import CODES, LOST, is_known
from monitor.memory.content import Content
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.lock import Lock
from monitor.memory.reference import Reference, Seen


class Condition(NamedTuple):
    """The finding of opening a fault memory."""

    state: Literal["ok", "repaired", "lost"] = "ok"
    says: str = ""  # one line, if the state is not ok
    set_aside: Path | None = None  # of a lost memory: the copy of its file

    @property
    def entry(self) -> dict[str, Any]:
        """Return the field ``memory`` of a result."""
        return {"state": self.state, "set_aside": self.set_aside and str(self.set_aside)}


class Memory:
    """Stores the fault memory in two files, which are made if they do not exist.

    hold : lock the memory against other processes that hold it, until ``close``; else each storing
        locks it
    Raises RecordingError if the file is no fault memory, has a newer schema, or is held by another
    process. Damage is no error: ``condition`` says what opening found.
    """

    def __init__(self, path: Path, *, hold: bool = False) -> None:
        self._path, self._block = path, Block(path)
        self._lock = Lock(path, self._block.files[0])
        self._is_held, self._is_closed = hold, False
        self._is_sure = False  # the content in RAM is that of both files
        if hold:
            self._lock.take()
        try:
            self._content, self.condition = self._opened()
        except BaseException:
            self.close()
            raise
        self._is_sure = hold

    def _opened(self) -> tuple[Content, Condition]:
        """Return the content, and how the files were found; make both hold it, if nobody works."""
        found = self._block.read()
        if not found.is_whole:
            try:
                with self._lock.taken():
                    found = self._repaired(self._block.read())  # another process may have done it
            except RecordingError:
                if self._lock.is_taken or found.content is None:
                    raise
        return found.content or Content(), self._condition(found)

    def _repaired(self, found: StoredContent) -> StoredContent:
        """Write what is left to both files; put them aside and begin anew if nothing is."""
        if found.is_whole:
            return found
        try:
            content = found.content or Content(set_aside=self._block.put_aside())
            self._block.write(content)
        except OSError as error:
            raise self._failed(error) from None
        return found._replace(content=content)

    def _failed(self, error: OSError) -> RecordingError:
        said = error.strerror or error
        return RecordingError(f"{self._path}: cannot store the fault memory: {said}")

    def _condition(self, found: StoredContent) -> Condition:
        if found.content and found.content.set_aside:  # until the loss is a stored code
            aside = self._block.files[0].with_name(found.content.set_aside)
            says = f"{self._path}: the fault memory was damaged, both files of it: codes, counts "
            says += "and the vehicle's reference are lost and begin anew; "
            return Condition("lost", f"{says}{aside} holds what is left", aside)
        if not found.says:
            return Condition()
        says = f"{self._path}: the fault memory was damaged: {found.says}; nothing is lost"
        return Condition("repaired", says)

    def load(self) -> Saved:
        """Return the stored content; raises RecordingError if it holds unknown codes."""
        for code in (dtc.code for dtc in self._content.saved.dtcs):
            if not is_known(code):
                raise RecordingError(f"{self._path}: unknown trouble code {code!r}")
        return self._content.saved

    def begin(self, profile: ProfileConfig) -> DtcStore:
        """Return the fault memory in RAM, with a driving cycle begun.

        Raises RecordingError as ``load``.
        """
        store = DtcStore(self.load(), profile)
        store.is_lost = bool(self._content.set_aside)
        store.start_driving_cycle()
        return store

    def reference(self, model_sha256: str) -> Reference:
        """Return the vehicle's reference for a model; an empty one if there is none."""
        return self._content.references.get(model_sha256, Reference())

    def learn(self, model_sha256: str, seen: Seen | None, config: BiasConfig) -> None:
        """Add a healthy drive to the vehicle's reference for a model; None adds nothing.

        Raises RecordingError if the files cannot be written.
        """
        if seen is None:
            return

        def learned(content: Content) -> Content:
            known = content.references.get(model_sha256, Reference())
            new = {model_sha256: known.learn(seen, config)}
            return replace(content, references={**content.references, **new})

        self._store(learned)

    def save(self, saved: Saved) -> None:
        """Store codes, frames and counts; nothing is written if they are stored already.

        Changes that another process made meanwhile are replaced. Raises RecordingError if the
        files cannot be written; they then hold the content before, or one of them the new one.
        """
        is_told = any(dtc.code in CODES[LOST] and dtc.fault for dtc in saved.dtcs)
        self._store(lambda c: replace(c, saved=saved, set_aside="" if is_told else c.set_aside))

    def forget_loss(self) -> None:
        """Store that the user knows of the lost memory before this one."""
        self._store(lambda before: replace(before, set_aside=""))

    def _store(self, change: Callable[[Content], Content]) -> None:
        if self._is_closed:
            raise RecordingError(f"{self._path}: cannot store the fault memory: it is closed")
        with self._lock.taken():
            is_whole = self._is_sure
            if not self._is_sure:
                found = self._block.read()
                self._content, is_whole = found.content or self._content, found.is_whole
            new = change(self._content)
            if new == self._content and is_whole:
                return
            new = replace(new, generation=new.generation + 1)
            self._is_sure = False
            try:
                self._block.write(new)
            except OSError as error:
                raise self._failed(error) from None
            self._content, self._is_sure = new, self._is_held

    def close(self) -> None:
        """Release the lock; nothing can be stored any more."""
        self._is_closed = True
        self._lock.let_go()
