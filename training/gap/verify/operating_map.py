"""The error of two models over speed and load."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.fit.comparison import Comparison
from training.recordings.samples.rows import hold

SIGNALS: Final = ("engine_speed_rpm", "air_mass_mg")
CELLS: Final = 10  # a side
SAMPLES_LEAST: Final = 30  # in a cell


@dataclass(frozen=True, slots=True)
class OperatingMap:
    """RMSE in phi on a grid of speed and load, NaN where hardly driven."""

    speed_rpm: FloatArray  # (CELLS + 1,) edges
    load_mg: FloatArray  # (CELLS + 1,)
    before: FloatArray  # (CELLS, CELLS), load by speed
    after: FloatArray | None  # None without a new model


def operating_map(before: Sequence[Comparison], after: Sequence[Comparison] | None) -> OperatingMap:
    """Return the errors of both models in the cells, on the scored samples of the same drives."""
    points = [np.concatenate([hold(r.signals[name])[r.scored] for r in before]) for name in SIGNALS]
    ends = ([float(q) for q in np.percentile(x, [0.5, 99.5])] for x in points)
    speed, load = (np.linspace(low, high, CELLS + 1) for low, high in ends)
    count = np.histogram2d(points[1], points[0], [load, speed])[0]

    def rmse(drives: Sequence[Comparison]) -> FloatArray:
        squares = np.concatenate([r.residual[r.scored] for r in drives]) ** 2
        total = np.histogram2d(points[1], points[0], [load, speed], weights=squares)[0]
        seen = count >= SAMPLES_LEAST
        return np.where(seen, np.sqrt(total / np.maximum(count, 1.0)), np.nan)

    return OperatingMap(speed, load, rmse(before), None if after is None else rmse(after))
