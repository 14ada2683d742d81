"""The columns map: which column of a table carries which canonical signal.

A TOML file; columns that it does not name keep their own names::

    lambda_measured = "AFR"                                          # as it is
    rail_pressure_mpa = { column = "FuelP", factor = 0.1, offset = 0.0 }
    time_s = { column = "t_ms", factor = 0.001 }                     # default: column time_s
"""

from dataclasses import dataclass
from pathlib import Path

from monitor.base.errors import ConfigError
from monitor.base.files.toml_table import TomlTable


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
    raw = TomlTable.of_file(path, "the columns map", ConfigError)
    return {name: _column(raw, name) for name in raw}


def _column(raw: TomlTable, name: str) -> Column:
    if not isinstance(raw.tree[name], dict):
        return Column(raw.value(name, str))
    own = raw.table(name)
    return own.record(Column(own.value("column", str)))
