"""Ridge regression with its penalty chosen on held-out blocks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray

PENALTIES: Final = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # times the samples, on columns of unit size
SPREAD_MIN: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Ridge:
    """A fitted ridge; it limits columns to the range of its fit."""

    weights: FloatArray  # (k,)
    low: FloatArray  # (k,)
    high: FloatArray
    held_out: FloatArray  # (n,) prediction of each sample by a fit without its fold
    penalty: float

    def predict(self, columns: FloatArray) -> FloatArray:
        """Return the prediction (n,) for columns (n, k)."""
        return np.asarray(np.clip(columns, self.low, self.high) @ self.weights)


def fit(
    columns: FloatArray,
    target: FloatArray,
    fold: IntArray,
    limits: tuple[FloatArray, FloatArray] | None = None,
    *,
    penalties: Sequence[float] = PENALTIES,
    alike: bool = False,
    prior: FloatArray | None = None,
) -> Ridge:
    """Return the ridge of ``target`` (n,) on ``columns`` (n, k) with the best held-out error.

    fold : (n,) number of the fold in which a sample is held out
    limits : low and high (k,) of columns to predict for, default those of ``columns``
    penalties : candidates, times the number of samples
    alike : the weights have one unit and size; columns keep their size instead of unit size
    prior : (k, k) precision of the weights for a target with noise 1
    Source: Hoerl and Kennard, Technometrics 12 (1970).
    """
    size = np.sqrt((columns**2).mean(axis=0))
    used = size > SPREAD_MIN
    scale = np.where(used & (not alike), size, 1.0)
    x = np.where(used, columns / scale, 0.0)
    y = target
    rows = [np.flatnonzero(fold == f) for f in np.unique(fold)]
    parts = [x[own] for own in rows]
    grams = [part.T @ part for part in parts]
    moments = [part.T @ y[own] for part, own in zip(parts, rows, strict=True)]
    gram, moment = sum(grams), sum(moments)
    identity = np.eye(x.shape[1])
    prior = np.zeros_like(identity) if prior is None else prior
    known = prior / np.outer(scale, scale)
    ridges = [penalty * len(y) * identity + known for penalty in penalties]
    held_out = np.zeros((len(ridges), len(y)))
    for own, part, own_gram, own_moment in zip(rows, parts, grams, moments, strict=True):
        rest, wanted = gram - own_gram, moment - own_moment
        held_out[:, own] = np.stack([np.linalg.solve(rest + r, wanted) for r in ridges]) @ part.T
    best = int(((y - held_out) ** 2).sum(axis=1).argmin())
    weights = np.linalg.solve(gram + ridges[best], moment) / scale
    weights = np.where(used | (np.diag(prior) > 0.0), weights, 0.0)
    low, high = limits or (columns.min(axis=0), columns.max(axis=0))
    return Ridge(weights, low, high, held_out[best], penalties[best])
