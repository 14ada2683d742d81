"""The repair of a fault memory whose main file must be made anew."""

import os
import shutil
from itertools import count
from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.memory import spare, tables
from monitor.memory.agreement import Condition, agreed, best
from monitor.memory.content import Content, Copy
from monitor.memory.lock import Lock
from monitor.memory.tables import BESIDE, DamagedError, Tables

ASIDE: Final = "-damaged-"  # between the name of a lost memory and its number
UNREADABLE: Final = Copy(None, frozenset(), "the main file cannot be read")


def repaired(
    path: Path, lock: Lock, damage: DamagedError
) -> tuple[Tables | None, Content, Condition]:
    """Make the main file anew from the whole parts; without any, put all aside and begin anew.

    If another process holds the lock, nothing is written and no tables are returned. Raises
    RecordingError if the files cannot be written, or if another process holds a lost memory.
    """
    beside = spare.spare_of(path)
    try:
        with lock.taken():
            try:
                return agreed(path)  # another process may have repaired it meanwhile
            except DamagedError as error:
                damage = error
            condition = Condition()
            try:
                content, says = best(_read(path), spare.read(beside), path)
                condition = Condition.repaired(path, says or str(damage))
            except DamagedError:
                content = Content(set_aside=_put_aside(path).name)
            _write_spare(path, content)
            tables.make(path, content)
            return Tables(path), content, condition
    except DamagedError as error:
        raise RecordingError(f"{path}: cannot store the fault memory: {error}") from None
    except RecordingError:
        if lock.is_taken:
            raise
        return None, *_as_read(path, damage)


def _as_read(path: Path, damage: DamagedError) -> tuple[Content, Condition]:
    """Return the readable part of a damaged memory that another process holds."""
    try:
        content, says = best(_read(path), spare.read(spare.spare_of(path)), path)
    except DamagedError:
        raise RecordingError(
            f"{path}: the fault memory is damaged: {damage}; it is in use by a running monitor, "
            "whose next start puts it aside"
        ) from None
    return content, Condition.repaired(path, says or str(damage))


def _read(path: Path) -> Copy:
    """Return the good part of the main file."""
    try:
        if tables.is_empty(path):
            return UNREADABLE
        main = Tables(path)
    except DamagedError as error:
        return UNREADABLE._replace(note=f"of the main file: {error}")
    try:
        return main.read()
    finally:
        main.close()


def _put_aside(path: Path) -> Path:
    """Give the files of a memory a second name; return that of the main file, or of the spare copy.

    The files keep their own names until new ones replace them: a kill meanwhile hides no loss.
    """
    names = (path.with_name(f"{path.name}{ASIDE}{n}") for n in count(1))
    free = next(n for n in names if not n.exists() and not spare.spare_of(n).exists())
    kept = []
    for suffix in ("", spare.SUFFIX, *BESIDE):
        old, new = (each.with_name(each.name + suffix) for each in (path, free))
        try:
            if old.exists():
                _link(old, new)
                kept.append(new)
        except OSError as error:
            raise RecordingError(f"{old}: cannot be put aside: {error.strerror}") from None
    return kept[0]


def _link(old: Path, new: Path) -> None:
    try:
        os.link(old, new)
    except OSError:  # a file system without links
        shutil.copyfile(old, new)


def _write_spare(path: Path, content: Content) -> None:
    beside = spare.spare_of(path)
    try:
        spare.write(beside, content)
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot store the fault memory: {beside.name}: {error.strerror}"
        ) from None
