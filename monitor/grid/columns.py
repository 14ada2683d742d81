"""The columns map: which column of a table carries which canonical signal.

A TOML file; columns that it does not name keep their own names::

    lambda_measured = "AFR"                                          # as it is
    rail_pressure_mpa = { column = "FuelP", factor = 0.1, offset = 0.0 }
    time_s = { column = "t_ms", factor = 0.001 }                     # default: column time_s
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monitor.base.errors import ConfigError
from monitor.base.files.inputs import read_toml


@dataclass(frozen=True, slots=True)
class Column:
    """Where one signal of a table comes from: value = factor * cell + offset."""

    column: str
    factor: float = 1.0
    offset: float = 0.0


def load_columns(path: Path) -> dict[str, Column]:
    """Return the columns map in the TOML file ``path``.

    Raises ConfigError naming file and key if it cannot be used.
    """
    raw = read_toml(path, "the columns map", ConfigError)
    return {name: _column(path, name, entry) for name, entry in raw.items()}


def _column(path: Path, name: str, entry: Any) -> Column:
    if isinstance(entry, str):
        return Column(entry)
    if not isinstance(entry, dict) or not isinstance(entry.get("column"), str):
        raise ConfigError(f"{path}: {name} is {entry!r}, a column's name is wanted")
    unknown = sorted(entry.keys() - {"column", "factor", "offset"})
    if unknown:
        raise ConfigError(f"{path}: [{name}] has the unknown key {unknown[0]!r}")
    for key in ("factor", "offset"):
        value = entry.get(key, 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"{path}: [{name}] {key} is {value!r}, a number is wanted")
    return Column(entry["column"], float(entry.get("factor", 1.0)), float(entry.get("offset", 0.0)))
