"""Principal components of the candidate inputs: scree, loadings, biplot, Q and T² over time."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import linalg, stats

from monitor.base.types import FloatArray

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
    return Components(
        mean=mean,
        std=std,
        variances=variances,
        loadings=loadings,
        kept=kept,
        samples=len(values),
    )


def pca(stretches: Sequence[tuple[FloatArray, FloatArray]], names: Sequence[str]) -> dict[str, Any]:
    """Return the principal component analysis as plain values.

    stretches : pairs of time in s (n_i,) and values (n_i, k); time runs through all stretches
    names : names of the k columns
    """
    t_s = np.concatenate([t for t, _ in stretches])
    values = np.concatenate([v for _, v in stretches])
    found = components(values)
    q, t2 = found.q(values), found.t_squared(values)
    scores = found.scores(values)
    some = np.linspace(0, len(values) - 1, min(POINTS, len(values))).astype(int)
    return {
        "names": list(names),
        "samples": len(values),
        "kept": found.kept,
        "variances": _short(found.variances),
        "explained": _short(np.cumsum(found.variances) / found.variances.sum()),
        "loadings": [_short(row) for row in found.loadings],
        "scores": [_short(scores[some, i]) for i in range(min(2, scores.shape[1]))],
        "q": _peaks(t_s, q),
        "q_limit": found.q_limit(),
        "q_beyond": float((q > found.q_limit()).mean()),
        "t_squared": _peaks(t_s, t2),
        "t_squared_limit": found.t_squared_limit(),
        "t_squared_beyond": float((t2 > found.t_squared_limit()).mean()),
        "alpha": ALPHA,
    }


def _peaks(t_s: FloatArray, values: FloatArray) -> dict[str, list[float]]:
    """Return the largest value in up to ``BINS`` equal parts of the time."""
    edges = np.linspace(0, len(values), min(BINS, len(values)) + 1).astype(int)
    return {
        "t_s": _short(t_s[edges[:-1]]),
        "largest": _short(np.maximum.reduceat(values, edges[:-1])),
    }


def _short(values: FloatArray) -> list[float]:
    return [float(f"{v:.5g}") for v in values]


def scree_figure(result: dict[str, Any]) -> Figure:
    """Draw the variances of the components, their cumulative share and the loadings."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 3))
    number = np.arange(1, len(result["variances"]) + 1)
    left.bar(number, result["variances"], color="#9db8d2")
    left.axvline(result["kept"] + 0.5, color="#999999", ls="--", lw=0.8)
    left.set_xticks(number)
    left.set_xlabel("component; kept ones left of the dashed line")
    left.set_ylabel("variance (bars)")
    other = left.twinx()
    other.plot(number, 100 * np.array(result["explained"]), "o-", color="#1f4e79", ms=3)
    other.set_ylim(0, 103)
    other.set_ylabel("explained together, % (line)")
    n = min(result["kept"] + 1, len(number))
    values = np.array(result["loadings"])[:, :n]
    image = right.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    right.set_yticks(range(len(result["names"])), result["names"])
    right.set_xticks(range(n), [str(i + 1) for i in range(n)])
    for (i, j), value in np.ndenumerate(values):
        ink = "white" if abs(value) > 0.6 else "black"
        right.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color=ink)
    right.set_xlabel("component")
    figure.colorbar(image, ax=right, label="loading")
    return figure


def biplot_figure(result: dict[str, Any]) -> Figure:
    """Draw scores and loadings of the first two components in one plane."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    axes = figure.subplots()
    for_scale = [np.percentile(np.abs(each), 99) or 1.0 for each in result["scores"]]
    one, two = (np.array(v) / scale for v, scale in zip(result["scores"], for_scale, strict=True))
    axes.plot(one, two, ".", color="#bbbbbb", ms=3)
    loadings = np.array(result["loadings"])[:, :2]
    for x, y in loadings:
        axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "->", "color": "#1f4e79"})
    for i, (x, y) in enumerate(_apart(loadings)):
        side = "left" if x > 0 else "right"
        axes.plot(*zip(loadings[i], (x, y), strict=True), color="#1f4e79", lw=0.4)
        axes.text(x, y, f" {result['names'][i]} ", fontsize=8, ha=side, va="center")
    reach = 1.45 * max(1e-3, float(np.abs(loadings).max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    share = np.array(result["variances"]) / np.sum(result["variances"])
    axes.set_xlabel(f"loading on component 1, {100 * share[0]:.0f} % of the variance")
    axes.set_ylabel(f"loading on component 2, {100 * share[1]:.0f} % of the variance")
    return figure


def _apart(loadings: FloatArray) -> FloatArray:
    """Return the places (k, 2) of the names: beyond the arrows and without overlap."""
    places = loadings * 1.1
    step = 0.07 * float(np.abs(loadings).max())
    for right in (True, False):
        side = np.flatnonzero((places[:, 0] > 0) == right)
        side = side[np.argsort(places[side, 1])]
        for below, above in itertools.pairwise(side):
            places[above, 1] = max(places[above, 1], places[below, 1] + step)
    return places


def control_figure(result: dict[str, Any]) -> Figure:
    """Draw Q residuals and Hotelling's T² over time with their limits."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, key, label in ((upper, "q", "Q residual"), (lower, "t_squared", "Hotelling's T²")):
        series = result[key]
        axes.semilogy(series["t_s"], series["largest"], lw=0.7, color="#1f4e79")
        limit = result[f"{key}_limit"]
        axes.axhline(limit, color="#c0392b", lw=0.9, ls="--", label=f"99 % limit {limit:.3g}")
        axes.set_ylabel(label)
        axes.legend(frameon=False, loc="upper right")
    lower.set_xlabel("time, s, drives end to end; the largest value of each stretch is drawn")
    return figure
