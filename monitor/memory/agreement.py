"""The common content of main file and spare copy of a fault memory.

=============  ===============  =======================================================  ========
main file      spare copy       content                                                  state
=============  ===============  =======================================================  ========
whole          whole, not newer the main file's; the spare copy is made anew             ok
whole          newer by one     the spare copy's: a kill came between the two storings   ok
whole          newer by more    the spare copy's: the main file lost its latest storings repaired
whole          none             the main file's; the spare copy is made anew             ok
whole          damaged          the main file's; nothing if it is an old one             repaired
damaged, gone  whole            the spare copy's; the main file is made anew             repaired
damaged        damaged          rows of both, if together they are whole                 repaired
damaged        damaged, none    nothing: both are put aside under new names              lost
=============  ===============  =======================================================  ========
"""

from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple

from monitor.memory import spare
from monitor.memory.content import TABLES, Content, Copy, joined
from monitor.memory.lock import noted
from monitor.memory.tables import ERRORS, DamagedError, Tables, is_empty


class Condition(NamedTuple):
    """The finding of opening a fault memory."""

    state: Literal["ok", "repaired", "lost"] = "ok"
    says: str = ""  # one line, if the state is not ok
    set_aside: Path | None = None  # of a lost memory: the new name of its main file

    @classmethod
    def repaired(cls, path: Path, says: str) -> "Condition":
        """Return the condition of a memory of which nothing was lost."""
        return cls("repaired", f"{path}: the fault memory was damaged: {says}; nothing is lost")

    @classmethod
    def lost(cls, path: Path, aside: Path) -> "Condition":
        """Return the condition of a memory that begins anew."""
        says = f"{path}: the fault memory was damaged, and so was its spare copy: codes, counts "
        says += f"and the vehicle's reference are lost and begin anew; {aside} holds what is left"
        return cls("lost", says, aside)

    @property
    def entry(self) -> dict[str, Any]:
        """Return the field ``memory`` of a result."""
        return {"state": self.state, "set_aside": self.set_aside and str(self.set_aside)}


OK = Condition()


def agreed(path: Path) -> tuple[Tables, Content, Condition]:
    """Open a memory and make its files equal; a memory that is not there is made.

    Raises DamagedError if the main file must be made anew, RecordingError as ``Tables``.
    """
    beside = spare.spare_of(path)
    if is_empty(path) and beside.exists():
        raise DamagedError("the main file is gone")
    tables = Tables(path)
    try:
        tables.check()
        main, copy = tables.read(), spare.read(beside)
        if main.content is None:  # what SQLite does not find wrong may be its own tables
            raise DamagedError(main.note)
        content, says = best(main, copy, path)
        if main.content == content and copy is not None and copy.content == content:
            return tables, content, OK
        with suppress(OSError), tables.transaction():  # a spare copy is written again when storing
            main, copy = tables.read(), spare.read(beside)  # nobody writes now
            content, says = best(main, copy, path)
            if main.content != content:
                tables.write(content, TABLES)
            if copy is None or copy.content != content:
                spare.write(beside, content)
    except ERRORS as error:
        meaning = tables.meaning_of_writing(error)
        if isinstance(meaning, DamagedError):
            tables.close()
            raise meaning from None
    except BaseException:
        tables.close()
        raise
    return tables, content, Condition.repaired(path, says) if says else OK


def best(main: Copy, copy: Copy | None, path: Path) -> tuple[Content, str]:
    """Return the content that two files hold together, and which damage was found, "" if none.

    path : of the main file
    Raises DamagedError if they hold none, or only an old one.
    """
    whole, spared = main.content, copy and copy.content
    if whole is None or copy is None:
        return _without_main(main, copy, path)
    if spared is None:
        says = f"of the spare copy {copy.note}; the main file was whole"
        return _latest(whole, copy, path), says
    if spared.memory != whole.memory or spared.generation <= whole.generation:
        return whole, ""
    is_next = spared.generation == whole.generation + 1
    says = "the main file had lost its latest storings; the spare copy was whole"
    return spared, "" if is_next else says


def _without_main(main: Copy, copy: Copy | None, path: Path) -> tuple[Content, str]:
    """Return the content if the main file is damaged, or if there is no spare copy."""
    if copy is None:
        if main.content is None:
            raise DamagedError(f"{main.note}, and there is no spare copy")
        return main.content, ""
    if copy.content is not None:
        return copy.content, f"{main.note}; the spare copy was whole"
    both = f"{main.note}, of the spare copy {copy.note}"
    heads = [head for head in (main.head, copy.head) if head]
    newest = max(heads, key=lambda head: head.generation, default=None)
    found = joined(newest, main.rows | copy.rows)
    if found is None:
        raise DamagedError(both)
    return _latest(found, copy, path), f"{both}; together they were whole"


def _latest(found: Content, copy: Copy, path: Path) -> Content:
    """Return a content of which no witness says that it is old; raises DamagedError for others.

    Witnesses are the note in the lock's file and the head of a damaged spare copy.
    """
    of_head = copy.head.generation if copy.head and copy.head.memory == found.memory else None
    try:
        generation = noted(path, found.memory)
    except ValueError:
        if of_head is None:
            raise DamagedError(f"of the spare copy {copy.note}, and the note is damaged") from None
        generation = None
    newest = of_head if generation is None else generation
    if newest is not None and newest > found.generation:
        raise DamagedError(
            f"the main file had lost its latest storings, and of the spare copy {copy.note}"
        )
    return found
