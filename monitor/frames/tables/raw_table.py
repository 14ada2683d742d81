"""A raw table: the columns of a logger's file under its own names, read in blocks.

A reader of a format is a function from a path to a ``RawTable``. Opening reads the header only;
``blocks`` reads the wanted columns, so a log of any length and width needs little memory.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, NamedTuple

from monitor.base.counts import counted
from monitor.base.types import BoolArray, FloatArray, IntArray

# of a column's cells; a clock's values are seconds, a measure's cells end in its unit
Kind = Literal["number", "clock", "text", "measure"]

DAY_S: Final = 86_400.0
HOUR_S: Final = 3_600.0


class Pivot(NamedTuple):
    """The columns of a table with one value a row: those of its name, value and unit."""

    name: str
    value: str
    unit: str = ""  # none


@dataclass(frozen=True, slots=True)
class RawColumn:
    """One column as the logger wrote it."""

    name: str
    unit: str = ""
    kind: Kind = "number"
    wraps_s: float = 0.0  # after which a clock starts again, 0 never
    others: tuple[str, ...] = ()  # further names that the file gives it


@dataclass(frozen=True, slots=True)
class Wanted:
    """A column to read: its number, and the words that count as 1 where its cells are text."""

    column: int
    words: tuple[str, ...] = ()


# counts of a reader in words: the noun of the number, and the rest
COUNTED: Final = {
    "markers": ("mark", "of the driver"),
    "repeated_headers": ("repeated header", "left out"),
    "bad_checksum": ("record", "with a wrong checksum left out"),
    "damaged_bytes": ("byte", "outside of any record passed over"),
    "rows_spread": ("row", "with the time of another one spread over the step to the next"),
    "rows_without_time": ("row", "without a time left out"),
    "rows_out_of_order": ("row", "older than one before left out"),
    "repeated_times": ("row", "with the time of the next one left out"),
    "held_cells": ("blank cell", "filled with the value before it"),
    "clock_wraps": ("time", "the clock started again (midnight, a full hour or a full counter)"),
    "logs_begun_anew": ("time", "the log begins anew, taken as a pause of 10 s"),
}


@dataclass(slots=True)
class Notes:
    """Oddities that a reader met, to be told: counts by name, and sentences."""

    counts: dict[str, int] = field(default_factory=dict)
    sentences: list[str] = field(default_factory=list)

    def count(self, name: str, n: int = 1) -> None:
        """Add ``n`` to a count; nothing is stored for 0."""
        if n:
            self.counts[name] = self.counts.get(name, 0) + n

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the notes in words, the sentences first."""
        told = ((n, *COUNTED[name]) for name, n in self.counts.items())
        return (*self.sentences, *(f"{counted(n, noun)} {rest}" for n, noun, rest in told))


@dataclass(frozen=True, slots=True)
class RawTable:
    """One file of a logger, opened.

    read(wanted, notes) yields blocks (n, n_wanted) of float64, NaN for no value, in the order of
    the file; it raises ValueError, OSError or RecordingError for a file that cannot be read.
    """

    path: Path
    kind: str  # format in words
    columns: tuple[RawColumn, ...]
    read: Callable[[Sequence[Wanted], Notes], Iterator[FloatArray]]
    preamble: str = ""  # text before the columns: the ECU's signature, as a rule

    @property
    def names(self) -> tuple[str, ...]:
        """Return the columns' names."""
        return tuple(column.name for column in self.columns)


@dataclass(frozen=True, slots=True)
class Table:
    """One recording as a table of canonical signals."""

    path: Path
    names: tuple[str, ...]  # without time_s
    t_ns: IntArray  # (n,) strictly rising
    values: FloatArray  # (n, n_names), NaN where the cell is blank
    pinned: BoolArray | None = None  # (n, n_names) the logger's value for "no sensor"; None nowhere
    notes: Notes = field(default_factory=Notes)
    profile: str = ""  # of a logger's file
    columns: Mapping[str, str] = field(default_factory=dict)  # name → origin
    blank: Mapping[str, str] = field(default_factory=dict)  # signal → its column without values
    updates: Mapping[str, int] = field(default_factory=dict)  # signal → cells that hold a value

    def column_of(self, name: str) -> str:
        """Return where a signal comes from, as the user knows it."""
        return self.columns.get(name, f"column {name}")
