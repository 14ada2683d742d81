"""How much healthy readings move, beside what the model predicts."""

import math
from collections.abc import Sequence

import numpy as np

from monitor.judge.residual import oriented, whitened
from monitor.pipeline.events import WindowJudged


def movement_of(windows: Sequence[WindowJudged], transform: str, memory: float) -> float:
    """Return the movement of the measurement over that of the prediction, 0 without any.

    memory : correlation of the healthy residual's neighbouring samples
    """
    if not windows:
        return 0.0
    measured = oriented(np.array([w.window.measured for w in windows]), transform)
    predicted = np.array([w.window.bank[:, 0] for w in windows])
    moved, expected = (float(np.square(whitened(x, memory)).sum()) for x in (measured, predicted))
    return math.sqrt(moved / expected) if expected else 0.0
