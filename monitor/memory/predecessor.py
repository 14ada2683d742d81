"""Fault memories of schema 4: a SQLite file with a spare copy in text, which is read once.

Every line of the spare copy has a checksum, and its head a digest of them all. The spare copy was
stored before the main file, so it is never older.
"""

import hashlib
import json
from collections import defaultdict
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import RecordingError
from monitor.memory.content import Content
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import Saved
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult
from monitor.memory.reference import Reference

SQLITE: Final = b"SQLite format 3\0"
BESIDE: Final = ("-spare", "-wal", "-shm")  # files that it had beside the main file


def is_there(path: Path, data: bytes) -> bool:
    """Return whether a memory of schema 4 is there; ``data`` is what its main file holds."""
    return data.startswith(SQLITE) or _spare_of(path).exists()


def remove_rest(path: Path) -> None:
    """Remove the files beside a main file that was converted; raises OSError."""
    for suffix in BESIDE:
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def content_of(path: Path) -> Content:
    """Return the content of a memory of schema 4; raises RecordingError if it has no whole copy."""
    try:
        rows = [_row(line) for line in _spare_of(path).read_bytes().splitlines()]
        (head,) = (row for row in rows if row[1] == "head")
        rows.remove(head)
        digest = _sha256("".join(sorted(checksum for checksum, *_ in rows)))
        if head[2] == 4 and head[-1] == digest:
            tables = defaultdict[str, list[Any]](list)
            for table, *row in sorted(row[1:] for row in rows):
                tables[table].append(row)
            return _content(tables, *head[3:6])
    except (OSError, ValueError, TypeError):
        pass
    raise RecordingError(
        f"{path}: not a fault memory, or one of an earlier version (SQLite) without a whole spare "
        "copy: let that version repair it (o2mon dtc list), or choose another file"
    )


def _row(line: bytes) -> list[Any]:
    """Return checksum and row of a line; raises ValueError if they do not fit."""
    found, text = line.decode().split(" ", 1)
    if _sha256(text)[:16] != found:
        raise ValueError("the line has changed")
    return [found, *json.loads(text)]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _content(tables: dict[str, list[Any]], memory: str, generation: int, set_aside: str) -> Content:
    signals = {code: (t_ns, json.loads(text)) for _, code, t_ns, text in tables["freeze_frame"]}
    latest = {code: values.pop("latest", None) for code, (_, values) in signals.items()}
    saved = Saved(
        dtcs=tuple(
            Dtc(code, fault, tuple(filter(None, also.split(","))), Status(status), *numbers)
            for code, fault, also, status, *numbers in tables["dtc"]
        ),
        freeze_frames=tuple(FreezeFrame(code, *found) for code, found in signals.items()),
        latest_frames=tuple(
            FreezeFrame(code, found.pop("t_ns"), found) for code, found in latest.items() if found
        ),
        permanent={code: fault for _, code, fault in tables["permanent"]},
        results=tuple(TestResult(*row) for row in tables["result"]),
        ratios=tuple(Ratio(*row) for row in tables["ratio"]),
        counts=Counts(**dict(tables["counted"])),
        completed=frozenset(test for (test,) in tables["completed"]),
    )
    references = {model: Reference(*numbers) for model, *numbers in tables["reference"]}
    return Content(saved, references, memory, generation, set_aside)


def _spare_of(path: Path) -> Path:
    return path.with_name(path.name + "-spare")
