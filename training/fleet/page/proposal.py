"""Proposed limits for a wished false-alarm rate, from the vehicles of the fleet, with bounds.

Vehicles without a code count as sound. A proposed limit is an order statistic that keeps the rate
with 95 % confidence by two bounds: the bound of Clopper and Pearson, which treats all values as
independent, and a bound from drawing whole vehicles, because values of one vehicle resemble each
other. Both bounds hold for any distribution.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from monitor.base.types import FloatArray, IntArray
from training.limits.rates import Figures, rate
from training.limits.tolerance import quantile_bounds, tolerance_limit, windows_needed

GROUPS: Final = 500  # most groups to draw; more vehicles share groups


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity with a limit in the model card."""

    name: str  # of the limit in the model card
    title: str
    of: str  # "window" or "drive"
    column: str  # of the table of windows or of recordings
    score: Callable[[FloatArray], FloatArray]  # column → score; a score at the limit alarms
    why: str  # use of the limit


QUANTITIES: Final = (
    Quantity(
        name="j_mu",
        title="|mean residual|",
        of="window",
        column="mean",
        score=np.abs,
        why="paper's rule, mean",
    ),
    Quantity(
        name="j_sigma",
        title="residual's spread",
        of="window",
        column="std",
        score=np.asarray,
        why="paper's rule, spread",
    ),
    Quantity(
        name="offset",
        title="|offset| at the drive's end",
        of="drive",
        column="offset",
        score=np.abs,
        why="bias rule, for vehicles without a reference",
    ),
)


def proposals(
    recordings: pl.DataFrame, windows: Path, wished: float, now: Mapping[str, float]
) -> list[Figures]:
    """Return one proposal per quantity.

    recordings : the table of recordings; windows : path of the table of windows
    wished : false-alarm rate per window or per drive
    now : present limits of the model, name → limit
    A proposal holds the present limit ``now`` with its rate ``now_rate``; the ``quantile`` of the
    wished rate with its bounds, None beyond the values; the limit ``proposed``, None with fewer
    than ``needed`` values.
    """
    faulty = recordings.filter(pl.col("fault_flag"))["vehicle"].unique()
    sound = recordings.filter(
        pl.col("error").is_null() & ~pl.col("vehicle").is_in(faulty.implode())
    )
    places = sound.select("recording", pl.col("vehicle").rank("dense").alias("place") - 1)
    result = []
    for quantity in QUANTITIES:
        if quantity.of == "window":
            part = pl.scan_parquet(windows).select("recording", quantity.column).collect()
        else:
            part = sound.select("recording", quantity.column)
        part = part.join(places, on="recording", maintain_order="left").drop_nulls()
        scores = np.asarray(quantity.score(part[quantity.column].to_numpy()))
        groups = part["place"].to_numpy().astype(np.int64) % GROUPS
        result.append(_proposal(quantity, scores, groups, wished, now[quantity.name]))
    return result


def _proposal(
    quantity: Quantity, scores: FloatArray, groups: IntArray, wished: float, now: float
) -> Figures:
    n, needed = len(scores), windows_needed(wished)
    low, high = quantile_bounds(scores, 1.0 - wished) if n else (None, None)
    return {
        "name": quantity.name,
        "title": quantity.title,
        "of": quantity.of,
        "why": quantity.why,
        "values": n,
        "needed": needed,
        "wished": wished,
        "now": now,
        "now_rate": rate(int((scores >= now).sum()), n),
        "quantile": float(np.quantile(scores, 1.0 - wished, method="inverted_cdf")) if n else None,
        "quantile_low": low,
        "quantile_high": high,
        "proposed": tolerance_limit(scores, groups, wished) if n >= needed else None,
    }
