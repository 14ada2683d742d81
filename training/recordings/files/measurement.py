"""Measurement files of calibration tools: MDF 3 and 4 with channels at several rasters."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.signals import BY_NAME
from monitor.base.types import FloatArray, IntArray
from monitor.frames import mdf as mdf4
from monitor.frames.profiles.conversion import Choice, converted, is_of_quantity
from monitor.frames.profiles.profile import STOICH_AFR, Profile, Source
from monitor.frames.tables.raw_table import RawColumn
from monitor.grid.columns import Column, load_columns
from monitor.grid.tables import TIME

SUFFIXES: Final = (".mf4", ".mdf", ".dat")
_BUS_EVENT: Final = 2  # flag of MDF 4 channel groups that hold frames


def is_measurement(path: Path, columns: str | Path | None = None) -> bool:
    """Return whether ``path`` is a measurement file and not a log of CAN frames.

    An .mf4 file may be either; one with a columns map or without frames is a measurement.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES or not path.is_file():
        return False
    if suffix != ".mf4" or columns is not None:
        return True
    with _open(path) as mdf:
        return not any(
            getattr(group.channel_group, "flags", 0) & _BUS_EVENT for group in mdf.groups
        )


def read_measurement(
    path: Path, columns: str | Path | None = None
) -> dict[str, tuple[IntArray, FloatArray]]:
    """Return times in nanoseconds and values of each channel, each at its own raster.

    columns : a columns map that names the channels; without it all numeric channels
    A unit that the file states is converted to that of the signal, unless the map converts.
    A channel that was recorded at several rasters is taken from the fastest.
    Raises RecordingError if the file cannot be read or lacks a channel.
    """
    mapping = load_columns(Path(columns)) if columns is not None else None
    with _open(path) as mdf:
        if mapping is None:
            times = {mdf.groups[group].channels[at].name for group, at in mdf.masters_db.items()}
            mapping = {name: Column(name) for name in mdf.channels_db if name not in times}
        found = {
            name: series
            for name, each in mapping.items()
            if name != TIME and (series := _series(path, mdf, name, each)) is not None
        }
    if not found:
        raise RecordingError(f"{path}: no channel with numbers in the measurement file")
    return found


def _series(path: Path, mdf: Any, name: str, column: Column) -> tuple[IntArray, FloatArray] | None:
    """Return one channel in the unit of the signal, None if it holds no numbers."""
    places = mdf.channels_db.get(column.column)
    if not places:
        raise RecordingError(f"{path}: no channel {column.column!r} in the measurement file")
    group, index = max(places, key=lambda at: int(mdf.groups[at[0]].channel_group.cycles_nr))
    signal = mdf.get(group=group, index=index)
    samples = np.asarray(signal.samples)
    if samples.ndim != 1 or samples.dtype.kind not in "biuf" or len(samples) == 0:
        return None
    t_ns: IntArray = np.rint(np.asarray(signal.timestamps) * 1e6).astype(np.int64) * 1000
    values = samples.astype(np.float64) * column.factor + column.offset
    if name in BY_NAME and (column.factor, column.offset) == (1.0, 0.0):
        source, raw = Source(column=column.column), RawColumn(column.column, signal.unit)
        if not is_of_quantity(name, source, raw, STOICH_AFR):
            wanted = f"one of {name} ({BY_NAME[name].unit}) is wanted"
            raise RecordingError(f"{path}: channel {raw.name!r} has the unit {raw.unit}, {wanted}")
        values = converted(Profile(name="", title=""), Choice(name, source, 0), raw, values)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
    if np.any(np.diff(t_ns) < 0):
        raise RecordingError(f"{path}: the times of channel {column.column!r} fall")
    return t_ns, values


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    asammdf = asammdf_for(path, "reading")
    try:
        with mdf4.quiet(), path.open("rb") as file:
            is_mf4 = path.suffix.lower() == ".mf4"
            source = mdf4.mended(file)[0] if is_mf4 else io.BytesIO(file.read())
            measurement = asammdf.MDF(source)
    except Exception as error:  # asammdf raises whatever its parsers raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: cannot read the measurement file: {reason}") from error
    with measurement:
        yield measurement


def asammdf_for(path: Path, use: str) -> ModuleType:
    """Return the library; raises RecordingError naming the file and its use if it is not there."""
    try:
        return import_module("asammdf")
    except ImportError as error:
        raise RecordingError(
            f"{path}: {use} it needs asammdf: pip install '.[mdf]' in the project's folder"
        ) from error
