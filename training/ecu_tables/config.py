"""Settings of the tables from ``default.toml`` beside this file."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from monitor.base.files.settings import ShippedSettings


@dataclass(frozen=True, slots=True)
class TablesConfig:
    """Numbers that decide the content of a cell."""

    z90: float  # half width of a 90 % interval in standard deviations
    air_scale: float  # standard deviation of the logarithm of the air estimate's scale
    least_s: float  # usable samples nearest to a cell, below which it is blank
    widest: Mapping[str, float]  # table → relative half width from which a cell is blank
    bluntest: Mapping[str, float]  # table → half width in its unit from which a cell is blank
    widening: Mapping[str, Mapping[str, float]]  # kind of air, table → factor on the deviation


@cache
def defaults() -> TablesConfig:
    """Return the settings of ``default.toml``."""
    read: dict[str, Any] = {**ShippedSettings("training.ecu_tables").values()}
    return TablesConfig(**read.pop("interval"), **read.pop("cell"), **read)


def rough() -> TablesConfig:
    """Return the settings that fill a cell however wide its interval is in the table's unit."""
    return replace(defaults(), bluntest={})
