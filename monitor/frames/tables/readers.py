"""The reader of a file: by its first bytes and its suffix, or by a plug-in for its suffix.

A plug-in brings a reader by the entry point ``o2_monitor.readers``: its name is the suffix without
the point, its object a function from a path to a ``RawTable``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.base.foreign import ForeignError, foreign, returned
from monitor.base.types import FloatArray
from monitor.frames.bounds import head_of
from monitor.frames.tables import delimited, mlg
from monitor.frames.tables.raw_table import Notes, Pivot, RawTable, Wanted

GROUP: Final = "o2_monitor.readers"
TEXT: Final = (".csv", ".msl", ".txt", ".tsv", ".vbo", ".ascii")
SUFFIXES: Final = (*TEXT, ".mlg")


def suffix_of(path: Path) -> str:
    """Return the suffix in small letters, without .gz.

    >>> suffix_of(Path("Drive.MSL.gz"))
    '.msl'
    """
    name = path.name.lower().removesuffix(".gz")
    return Path(name).suffix


@cache
def plugins() -> dict[str, EntryPoint]:
    """Return the plug-ins' readers by suffix."""
    return {f".{each.name.lower()}": each for each in entry_points(group=GROUP)}


def is_readable(path: Path) -> bool:
    """Return whether a reader knows the file's suffix."""
    return suffix_of(path) in SUFFIXES or suffix_of(path) in plugins()


def open_table(path: Path, pivot: Pivot | None = None) -> RawTable:
    """Return the file's raw table.

    pivot : columns of a text table with one value a row
    Raises RecordingError naming the file if it cannot be read.
    """
    suffix = suffix_of(path)
    if not is_readable(path):
        raise RecordingError(
            f"{path}: not a table; 'o2train table' reads .mf4, .mdf; text ends in {' '.join(TEXT)}"
        )
    try:
        if suffix in plugins():
            return _through_plugin(path, plugins()[suffix])
        if suffix == ".mlg" or head_of(path, len(mlg.MAGIC)) == mlg.MAGIC:
            return mlg.open_mlg(path)
        return delimited.open_delimited(path, pivot)
    except (OSError, EOFError, ValueError) as error:
        raise RecordingError(f"{path}: cannot read it: {reason(error)}") from error


def _through_plugin(path: Path, plugin: EntryPoint) -> RawTable:
    name = f"the reader {plugin.value}"
    try:
        raw = returned(name, lambda: plugin.load()(path), RawTable)
    except ForeignError as error:
        if isinstance(error.__cause__, RecordingError):
            raise error.__cause__ from None
        raise RecordingError(f"{path}: {error}") from error

    def read(wanted: Sequence[Wanted], notes: Notes) -> Iterator[FloatArray]:
        with foreign(name):
            yield from raw.read(wanted, notes)

    return replace(raw, read=read)


def reason(error: Exception) -> str:
    """Return an error in a few words."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
