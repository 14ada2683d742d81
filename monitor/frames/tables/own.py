"""The project's own tables: CSV with commas and points, every cell a number or blank."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Final

import numpy as np

from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.frames.bounds import open_binary, open_text
from monitor.frames.tables.cells import is_plain, numeral

_ROWS: Final = 1 << 14  # read before they become an array, which takes less memory
_HEAD: Final = 1 << 16  # bytes that tell the dialect


def header_of(path: Path) -> list[str] | None:
    """Return the names of the columns, None if the table has another dialect.

    Raises OSError as ``open``.
    """
    with open_binary(path) as file:
        lines = file.read(_HEAD).split(b"\n", 2)[:2]
    if any(mark in line for line in lines for mark in (b'"', b";", b"\t", b"\0")):
        return None
    return _names(lines[0].decode("utf-8", errors="replace"))


def _names(line: str) -> list[str]:
    return [name.strip() for name in line.lstrip("\ufeff").split(",")]


def read_own(path: Path) -> tuple[list[str], FloatArray]:
    """Return the names of the columns and all cells, (n, n_columns); blank cells are NaN.

    Raises RecordingError naming file, line and column for a cell that is no number or a row of
    another length.
    """
    try:
        with _open(path) as file:
            header = _names(file.readline())
            return header, _cells(path, header, file)
    except (OSError, EOFError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordingError(f"{path}: cannot read the table: {reason}") from error


def _open(path: Path) -> IO[str]:
    """Open a table; one that is not UTF-8 is Windows' own Western encoding."""
    with open_binary(path) as file:
        header = file.readline(_HEAD)
    try:
        header.decode("utf-8")
    except UnicodeDecodeError:
        return open_text(path, "cp1252", errors="replace")
    return open_text(path, "utf-8", errors="strict")


def _cells(path: Path, header: Sequence[str], lines: IO[str]) -> FloatArray:
    width = len(header)
    rows: list[list[float]] = []
    blocks = [np.empty((0, width))]
    for number, line in enumerate(lines, 2):
        text = line.strip()
        if not text:
            continue
        parts = text.split(",")
        if len(parts) != width:
            raise RecordingError(
                f"{path}: line {number}: {counted(len(parts), 'cell')}, "
                f"the header has {counted(width, 'column')}"
            )
        try:
            if not is_plain(text):
                raise ValueError
            rows.append([float(part) for part in parts])
        except ValueError:
            rows.append([_cell(path, number, *each) for each in zip(header, parts, strict=True)])
        if len(rows) == _ROWS:
            blocks.append(np.array(rows))
            rows = []
    blocks.append(np.array(rows, dtype=np.float64).reshape(len(rows), width))
    return np.concatenate(blocks)


def _cell(path: Path, number: int, name: str, text: str) -> float:
    try:
        return numeral(text) if text.strip() else math.nan
    except ValueError:
        raise RecordingError(
            f"{path}: line {number}: column {name} is {text.strip()[:40]!r}, a number is wanted"
        ) from None
