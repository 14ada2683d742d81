"""The limits of a model beside the values of a fleet's sound vehicles.

Vehicles without a code count as sound. The quantile that a wished rate of them reaches has bounds
by order statistics, which hold for independent values of any distribution; values of one vehicle
resemble each other, so a fleet of few vehicles knows less.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from monitor.base.types import FloatArray
from training.limits.rates import Figures, quantile_bounds, rate


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


def limits_beside(
    recordings: pl.DataFrame, windows: Path, wished: float, now: Mapping[str, float]
) -> list[Figures]:
    """Return what is known of the limit of each quantity.

    recordings : the table of recordings; windows : path of the table of windows
    wished : false-alarm rate per window or per drive
    now : present limits of the model, name → limit
    Each holds the present limit ``now`` with its rate ``now_rate``, and the ``quantile`` of the
    wished rate with its bounds, None beyond the values.
    """
    faulty = recordings.filter(pl.col("fault_flag"))["vehicle"].unique()
    sound = recordings.filter(
        pl.col("error").is_null() & ~pl.col("vehicle").is_in(faulty.implode())
    )
    result = []
    for quantity in QUANTITIES:
        if quantity.of == "window":
            part = pl.read_parquet(windows, columns=["recording", quantity.column], glob=False)
        else:
            part = sound.select("recording", quantity.column)
        part = part.join(sound.select("recording"), on="recording").drop_nulls()
        scores = np.asarray(quantity.score(part[quantity.column].to_numpy()))
        result.append(_of(quantity, scores, wished, now[quantity.name]))
    return result


def _of(quantity: Quantity, scores: FloatArray, wished: float, now: float) -> Figures:
    n = len(scores)
    low, high = quantile_bounds(scores, 1.0 - wished) if n else (None, None)
    return {
        "name": quantity.name,
        "title": quantity.title,
        "of": quantity.of,
        "why": quantity.why,
        "values": n,
        "wished": wished,
        "now": now,
        "now_rate": rate(int((scores >= now).sum()), n),
        "quantile": float(np.quantile(scores, 1.0 - wished, method="inverted_cdf")) if n else None,
        "quantile_low": low,
        "quantile_high": high,
    }
