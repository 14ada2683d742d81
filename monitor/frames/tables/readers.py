"""The reader of a file: by its first bytes and its suffix."""

from pathlib import Path
from typing import Final

from monitor.base.errors import RecordingError
from monitor.frames.bounds import head_of
from monitor.frames.tables import delimited, mlg
from monitor.frames.tables.raw_table import Pivot, RawTable

TEXT: Final = (".csv", ".msl", ".txt", ".tsv", ".vbo", ".ascii", ".lvm")
SUFFIXES: Final = (*TEXT, ".mlg")


def suffix_of(path: Path) -> str:
    """Return the suffix in small letters, without .gz.

    >>> suffix_of(Path("Drive.MSL.gz"))
    '.msl'
    """
    name = path.name.lower().removesuffix(".gz")
    return Path(name).suffix


def open_table(path: Path, pivot: Pivot | None = None) -> RawTable:
    """Return the file's raw table.

    pivot : columns of a text table with one value a row
    Raises RecordingError naming the file if it cannot be read.
    """
    if suffix_of(path) not in SUFFIXES:
        raise RecordingError(
            f"{path}: not a table; 'o2train table' reads .mf4, .mdf; text ends in {' '.join(TEXT)}"
        )
    try:
        if suffix_of(path) == ".mlg" or head_of(path, len(mlg.MAGIC)) == mlg.MAGIC:
            return mlg.open_mlg(path)
        return delimited.open_delimited(path, pivot)
    except (OSError, EOFError, ValueError) as error:
        raise RecordingError(f"{path}: cannot read it: {reason(error)}") from error


def reason(error: Exception) -> str:
    """Return an error in a few words."""
    said = getattr(error, "strerror", None) or str(error)
    return " ".join(said.split()) or type(error).__name__
