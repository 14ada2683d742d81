"""The content of a fault memory as rows of tables, each row and the whole with a checksum.

A file of the memory holds a head and rows. The head says which memory it is, how often it was
stored, and the digest of all rows, so that a row that is missing shows as well as one that changed.
"""

import hashlib
import json
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, field, replace
from typing import Any, Final, NamedTuple

from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import Saved
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult
from monitor.memory.reference import Reference

SCHEMA_VERSION: Final = 4
CHECKSUM_DIGITS: Final = 16  # of a sha256, in hexadecimal
TABLES: Final = (
    *("dtc", "freeze_frame", "permanent", "result", "ratio", "counted", "completed"),
    "reference",
)
LATEST: Final = "latest"  # name among a freeze frame's signals; no signal is named so
Row = tuple[Any, ...]
Rows = Mapping[str, list[Row]]  # by table; all rows of a table are replaced together


class Head(NamedTuple):
    """The head of a file, beside its rows."""

    schema: int
    memory: str  # identity: copies of one memory share it
    generation: int  # counts the times that the memory was stored
    set_aside: str  # file of the lost memory before this one, until its loss is a stored code
    digest: str  # of all rows


@dataclass(frozen=True, slots=True)
class Content:
    """A fault memory: its rows and its identity."""

    rows: Rows = field(default_factory=lambda: {table: [] for table in TABLES})
    memory: str = field(default_factory=lambda: secrets.token_hex(8))
    generation: int = 0
    set_aside: str = ""

    @property
    def head(self) -> Head:
        """Return the head of a file with this content."""
        rows = ((table, row) for table, rows in self.rows.items() for row in rows)
        digest = digest_of(checksum(table, row) for table, row in rows)
        return Head(SCHEMA_VERSION, self.memory, self.generation, self.set_aside, digest)

    def after(self, changed: Rows) -> "Content":
        """Return the content after one more storing, with some tables replaced."""
        return replace(self, rows={**self.rows, **changed}, generation=self.generation + 1)

    def reference(self, model_sha256: str) -> Reference:
        """Return the vehicle's reference for a model; an empty one if there is none."""
        found = {row[0]: row[1:] for row in self.rows["reference"]}
        return Reference(*found[model_sha256]) if model_sha256 in found else Reference()


class Copy(NamedTuple):
    """Parts of a file whose checksums are right; ``note`` names the damage of the others."""

    head: Head | None
    rows: frozenset[tuple[str, Row]]
    note: str = ""

    @property
    def content(self) -> Content | None:
        """Return the content if all of it is there."""
        return joined(self.head, self.rows)


def joined(head: Head | None, rows: Iterable[tuple[str, Row]]) -> Content | None:
    """Return the content of a head and rows, None if a row is missing or too many."""
    if head is None or head.schema != SCHEMA_VERSION:
        return None
    tables: dict[str, list[Row]] = {table: [] for table in TABLES}
    for table, row in sorted(rows, key=json.dumps):
        if table not in tables:
            return None
        tables[table].append(row)
    for table in ("freeze_frame", "permanent"):
        tables[table].sort(key=lambda row: row[0])  # their place
    found = Content(tables, head.memory, head.generation, head.set_aside)
    return found if found.head == head else None


def checksum(table: str, row: Iterable[Any]) -> str:
    """Return the checksum of a row; raises TypeError for values that no row has."""
    return checksum_of(json.dumps([table, *row]))


def checksum_of(text: str) -> str:
    """Return the checksum of a row's or a head's text."""
    return hashlib.sha256(text.encode()).hexdigest()[:CHECKSUM_DIGITS]


def digest_of(checksums: Iterable[str]) -> str:
    """Return the digest of all rows, in whatever order they come."""
    return hashlib.sha256("".join(sorted(checksums)).encode()).hexdigest()


def rows_of(saved: Saved) -> dict[str, list[Row]]:
    """Return the rows of every table but the reference's, in the order of its columns."""
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
        "freeze_frame": _frame_rows(saved),
        "permanent": [(i, code, fault) for i, (code, fault) in enumerate(saved.permanent.items())],
        "result": [
            (r.test, r.quantity, *map(_real, (r.value, r.low, r.high))) for r in saved.results
        ],
        "ratio": [astuple(ratio) for ratio in saved.ratios],
        "counted": [
            (name, _real(n) if isinstance(n, float) else n)
            for name, n in asdict(saved.counts).items()
        ],
        "completed": [(test,) for test in sorted(saved.completed)],
    }


def _frame_rows(saved: Saved) -> list[Row]:
    """Return a row per code; the frame of its latest failure stands among the signals."""
    latest = {f.code: {LATEST: {"t_ns": f.t_ns, **f.values}} for f in saved.latest_frames}
    return [
        (place, f.code, f.t_ns, json.dumps({**f.values, **latest.get(f.code, {})}))
        for place, f in enumerate(saved.freeze_frames)
    ]


def _frames_of(rows: Iterable[Row]) -> tuple[list[FreezeFrame], list[FreezeFrame]]:
    """Return the first and the latest freeze frames of the codes."""
    first, later = [], []
    for _, code, t_ns, text in rows:
        signals = json.loads(text)
        latest = signals.pop(LATEST, None)
        first.append(FreezeFrame(code, t_ns, signals))
        if latest is not None:
            later.append(FreezeFrame(code, latest.pop("t_ns"), latest))
    return first, later


def reference_row(model_sha256: str, reference: Reference) -> Row:
    """Return the row of a vehicle's reference."""
    *numbers, drives = astuple(reference)
    return (model_sha256, *map(_real, numbers), drives)


def _real(value: float) -> float:
    """Return a number as SQLite gives it back: a float, and zero without a sign."""
    return float(value) + 0.0


def saved_of(rows: Rows) -> Saved:
    """Return the content of the tables' rows; raises ValueError or TypeError if damaged."""
    dtcs = []
    for code, fault, also, status, t_ns, failed, passed, warm_ups in rows["dtc"]:
        names = tuple(name for name in also.split(",") if name)
        dtcs.append(
            Dtc(
                code=code,
                fault=fault,
                also=names,
                status=Status(status),
                t_ns=t_ns,
                failed_cycles=failed,
                passed_cycles=passed,
                warm_ups=warm_ups,
            )
        )
    frames, latest = _frames_of(rows["freeze_frame"])
    return Saved(
        dtcs=tuple(dtcs),
        freeze_frames=tuple(frames),
        latest_frames=tuple(latest),
        permanent={code: fault for _, code, fault in rows["permanent"]},
        results=tuple(TestResult(*row) for row in rows["result"]),
        ratios=tuple(Ratio(*row) for row in rows["ratio"]),
        counts=Counts(**dict(rows["counted"])),
        completed=frozenset(test for (test,) in rows["completed"]),
    )
