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
    doubt: FloatArray  # (k, k) root of the weights' covariance for a target with noise 1

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
    largest: float = np.inf,
) -> Ridge:
    """Return the ridge of ``target`` (n,) on ``columns`` (n, k) with the best held-out error.

    fold : (n,) number of the fold in which a sample is held out
    limits : low and high (k,) of columns to predict for, default those of ``columns``
    penalties : candidates, times the number of samples
    alike : the weights have one unit and size; columns keep their size instead of unit size
    prior : (k, k) precision of the weights for a target with noise 1
    largest : held-out error beyond which an error counts no more
    Source: Hoerl and Kennard, Technometrics 12 (1970).
    """
    order = np.argsort(fold, kind="stable")  # the samples of a fold lie together
    edges = np.flatnonzero(np.diff(fold[order])) + 1
    parts, targets = np.split(columns[order], edges), np.split(target[order], edges)
    squares = [part.T @ part for part in parts]
    size = np.sqrt(np.diag(sum(squares)) / len(target))
    used = size > SPREAD_MIN
    scale = np.where(used & (not alike), size, 1.0)
    inverse = np.where(used, 1.0 / scale, 0.0)
    grams = [own * np.outer(inverse, inverse) for own in squares]
    moments = [part.T @ own * inverse for part, own in zip(parts, targets, strict=True)]
    gram, moment = sum(grams), sum(moments)
    identity = np.eye(len(scale))
    prior = np.zeros_like(identity) if prior is None else prior
    known = prior / np.outer(scale, scale)
    ridges = [penalty * len(target) * identity + known for penalty in penalties]
    held_out = np.empty((len(target), len(ridges)))
    for rows, part, own, seen in zip(np.split(order, edges), parts, grams, moments, strict=True):
        weights = [np.linalg.solve(gram - own + ridge, moment - seen) for ridge in ridges]
        held_out[rows] = part @ (np.array(weights) * inverse).T
    left = np.minimum(np.abs(target[:, np.newaxis] - held_out), largest)
    best = int((left**2).sum(axis=0).argmin())
    found = np.linalg.solve(gram + ridges[best], moment) / scale
    found = np.where(used | (np.diag(prior) > 0.0), found, 0.0)
    low, high = limits or (columns.min(axis=0), columns.max(axis=0))
    root = np.linalg.inv(np.linalg.cholesky(gram + ridges[best])).T * inverse[:, np.newaxis]
    return Ridge(found, low, high, held_out[:, best].copy(), penalties[best], root)
