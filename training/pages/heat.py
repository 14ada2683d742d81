"""Heat maps as HTML tables: a colour and a text in each cell, the last row on top."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np

from monitor.base.counts import plain
from monitor.base.types import FloatArray

LEVELS: Final = 8  # of colour


class HeatCell(NamedTuple):
    """A cell: its text, one below it, the level of its colour, and what the mouse shows."""

    value: str
    half: str = ""  # of an interval
    level: int | None = None  # 0 to LEVELS; None is blank
    place: str = ""


@dataclass(frozen=True, slots=True)
class Heat:
    """A map as a page shows it."""

    template: ClassVar[str] = "heat.html"
    corner: str
    columns: Sequence[str]
    rows: Sequence[tuple[str, Sequence[HeatCell]]]


def level(value: float, values: FloatArray) -> int | None:
    """Return the level of a value's colour among all ``values``, None if it is not finite.

    >>> level(3.0, np.array([[1.0, 3.0], [np.nan, 2.0]]))
    8
    """
    if not np.isfinite(value):
        return None
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return round(LEVELS * (value - low) / max(high - low, 1e-9))


def over_plane(corner: str, x: Sequence[float], y: Sequence[float], values: FloatArray) -> Heat:
    """Return the map of whole values (len(y) - 1, len(x) - 1) between edges; NaN is blank."""
    rows = [
        (
            plain(low),
            [HeatCell("" if np.isnan(v) else f"{v:.0f}", "", level(v, values)) for v in row],
        )
        for low, row in zip(y[:-1], values.tolist(), strict=True)
    ]
    return Heat(corner, [plain(low) for low in x[:-1]], rows[::-1])
