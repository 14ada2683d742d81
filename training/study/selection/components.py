"""Principal components of the candidate inputs: scree, loadings, biplot, Q and T² over time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, stats

from monitor.base.types import FloatArray
from training.jobs.json_tree import plain

ENOUGH = 0.9  # share of the variance that the kept components explain
ALPHA = 0.01  # share of normal samples beyond the limits of Q and T²
BINS = 700  # of the plots over time; a bin shows its largest value
POINTS = 500  # samples whose scores the biplot shows


@dataclass(frozen=True, slots=True)
class Components:
    """A principal component model of z-scored signals."""

    mean: FloatArray  # (k,)
    std: FloatArray  # (k,)
    variances: FloatArray  # (k,) eigenvalues of the correlation matrix, in falling order
    loadings: FloatArray  # (k, k) one column per component
    kept: int
    samples: int

    def scores(self, values: FloatArray) -> FloatArray:
        """Return all scores (n, k) of ``values`` (n, k)."""
        return np.asarray((values - self.mean) / self.std @ self.loadings)

    def q(self, values: FloatArray) -> FloatArray:
        """Return Q (n,), the squared residual outside the kept components."""
        return np.asarray((self.scores(values)[:, self.kept :] ** 2).sum(axis=1))

    def t_squared(self, values: FloatArray) -> FloatArray:
        """Return Hotelling's T² (n,) within the kept components."""
        kept = self.scores(values)[:, : self.kept]
        return np.asarray((kept**2 / self.variances[: self.kept]).sum(axis=1))

    def q_limit(self, alpha: float = ALPHA) -> float:
        """Return the limit that Q exceeds in a share ``alpha`` of samples, for normal residuals.

        Source: Jackson and Mudholkar, Technometrics 21 (1979).
        """
        rest = self.variances[self.kept :]
        one, two, three = (float((rest**power).sum()) for power in (1, 2, 3))
        if two <= 0.0:
            return 0.0
        h = 1.0 - 2.0 * one * three / (3.0 * two**2)
        normal = float(stats.norm.isf(alpha))
        inner = normal * np.sqrt(2.0 * two * h**2) / one + 1.0 + two * h * (h - 1.0) / one**2
        return float(one * inner ** (1.0 / h))

    def t_squared_limit(self, alpha: float = ALPHA) -> float:
        """Return the limit that T² exceeds in a share ``alpha`` of samples, for normal scores.

        Source: Jackson, A User's Guide to Principal Components (1991), section 1.7.
        """
        n, a = self.samples, self.kept
        scale = a * (n - 1.0) * (n + 1.0) / (n * (n - a))
        return float(scale * stats.f.isf(alpha, a, n - a))


def components(values: FloatArray, share: float = ENOUGH) -> Components:
    """Return the principal components of ``values`` (n, k), with n > k and no constant column.

    share : least share of the variance that the kept components explain; with more than one
        component the last is never kept, so that there is a residual
    """
    mean, std = values.mean(axis=0), values.std(axis=0, ddof=1)
    _, sizes, rows = linalg.svd((values - mean) / std, full_matrices=False)
    variances = sizes**2 / (len(values) - 1.0)
    kept = int(np.searchsorted(np.cumsum(variances) / variances.sum(), share) + 1)
    signs = np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])
    loadings = (rows * signs[:, np.newaxis]).T  # the largest loading of a component is positive
    kept = max(1, min(kept, len(variances) - 1))
    return Components(mean, std, variances, loadings, kept, len(values))


def pca(stretches: Sequence[tuple[FloatArray, FloatArray]], names: Sequence[str]) -> dict[str, Any]:
    """Return the principal component analysis as plain values.

    stretches : pairs of time in s (n_i,) and values (n_i, k); time runs through all stretches
    names : names of the k columns
    """
    t_s, values = (np.concatenate(each) for each in zip(*stretches, strict=True))
    found = components(values)
    q, t2 = found.q(values), found.t_squared(values)
    some = np.linspace(0, len(values) - 1, min(POINTS, len(values))).astype(int)
    edges = np.linspace(0, len(values), min(BINS, len(values)) + 1).astype(int)[:-1]
    result = {
        "variances": found.variances,
        "explained": np.cumsum(found.variances) / found.variances.sum(),
        "loadings": found.loadings,
        "scores": found.scores(values)[some, :2].T,
        "q": {"t_s": t_s[edges], "largest": np.maximum.reduceat(q, edges)},
        "t_squared": {"t_s": t_s[edges], "largest": np.maximum.reduceat(t2, edges)},
    }
    return {
        "names": list(names),
        "samples": len(values),
        "kept": found.kept,
        **plain(result),
        "q_limit": found.q_limit(),
        "q_beyond": float((q > found.q_limit()).mean()),
        "t_squared_limit": found.t_squared_limit(),
        "t_squared_beyond": float((t2 > found.t_squared_limit()).mean()),
        "alpha": ALPHA,
    }
