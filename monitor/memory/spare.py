"""The spare copy of a fault memory: a text file with a checksum before every line.

It is written beside and renamed, so it is never there in part, and a full disk leaves the copy
before it. It is stored before the main file, so it is never older.
"""

import json
import os
from pathlib import Path
from typing import Any, Final

from monitor.memory.content import Content, Copy, Head, checksum_of

SUFFIX: Final = "-spare"
LARGEST: Final = 16_000_000  # bytes; a memory of 100 codes has 30,000
_HEAD: Final = "head"


def spare_of(path: Path) -> Path:
    """Return the spare copy's file of a fault memory."""
    return path.with_name(path.name + SUFFIX)


def write(path: Path, content: Content) -> None:
    """Write the spare copy ``path``; raises OSError and leaves the copy before it."""
    lines = [[_HEAD, *content.head]]
    lines += [[table, *row] for table, rows in content.rows.items() for row in rows]
    texts = map(json.dumps, lines)
    begun = path.with_name(path.name + "-begun")
    with begun.open("w") as file:
        file.writelines(f"{checksum_of(text)} {text}\n" for text in texts)
        file.flush()
        os.fsync(file.fileno())
    begun.replace(path)


def read(path: Path) -> Copy | None:
    """Return the parts of a spare copy that are good, None if there is no file."""
    try:
        with path.open("rb") as file:
            lines = file.read(LARGEST).split(b"\n")
    except FileNotFoundError:
        return None
    except OSError as error:
        return Copy(None, frozenset(), str(error.strerror))
    head: Head | None = None
    rows, bad = set(), 0
    for line in filter(None, lines):
        match _good(line):
            case [str(kind), *fields] if kind == _HEAD and len(fields) == len(Head._fields):
                head = Head(*fields)
            case [str(table), *fields]:
                rows.add((table, tuple(fields)))
            case _:
                bad += 1
    note = f"{bad} of {len(lines) - 1} lines" if bad else "incomplete"
    return Copy(head, frozenset(rows), note)


def _good(line: bytes) -> Any:
    """Return the list in a line, None if its checksum does not fit."""
    try:
        found, text = line.decode().split(" ", 1)
        line_of = json.loads(text) if found == checksum_of(text) else []
        return None if any(isinstance(each, list | dict) for each in line_of) else line_of
    except (ValueError, RecursionError):
        return None
