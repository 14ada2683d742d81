"""What the healthy vehicle would read: a linear fit to healthy runs, each predicted without itself.

A network knows the recordings that trained it, so its error there says little of new ones. The
error of this fit on a run that it left out is like its error on a new run of a healthy vehicle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.response.drivers import rate
from training.gap.response.regressors import Regressors
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import lag

PENALTIES: Final = (1e-5, 1e-4, 1e-3, 1e-2)  # of the mean diagonal; the best predicts others
RIDGE: Final = 1e-3  # of the mean diagonal, of a family's fit
NOTHING: Final = 1e-20  # of a sum of squares: the runs do not move the columns
AGAIN: Final = 2
ABOUT_S: Final = 1.0
LARGEST: Final = 5.0  # spreads; a larger error counts as this, so that a few samples decide little


@dataclass(frozen=True, slots=True)
class ResponseReference:
    """The healthy vehicle's reading as a function of other signals, and the spread about it."""

    regressors: Regressors
    weights: FloatArray  # (m,)
    spread: "Spread"
    healthy: tuple[Comparison, ...]  # each beside the reading that the others predict

    @classmethod
    def learn(cls, healthy: Sequence[Comparison], inputs: Sequence[str]) -> "ResponseReference":
        """Return what healthy runs, two or more, say."""
        made = Regressors.of(healthy, inputs)
        tables = [made(r) for r in healthy]
        target = [r.phi_measured for r in healthy]
        predicted, weights = _fit(tables, target, healthy)
        for _ in range(AGAIN):  # errors beyond the largest are held at it
            beside = [replace(r, phi_predicted=p) for r, p in zip(healthy, predicted, strict=True)]
            spread = Spread.of(beside)
            target = [spread.held(r).phi_measured for r in beside]
            predicted, weights = _fit(tables, target, healthy)
        beside = [replace(r, phi_predicted=p) for r, p in zip(healthy, predicted, strict=True)]
        return cls(made, weights, spread, tuple(map(spread.held, beside)))

    @property
    def error(self) -> float:
        """Return the RMS error with which healthy runs tell each other's reading."""
        residual = np.concatenate([r.residual[r.scored] for r in self.healthy])
        return float(np.sqrt(np.mean(residual**2)))

    def excess(self, new: Sequence[Comparison]) -> float:
        """Return by how much the mean squared error of new runs exceeds that of healthy ones."""
        here, there = (
            np.concatenate([r.residual[r.scored] for r in runs])
            for runs in (self.beside(new), self.healthy)
        )
        return float(np.mean(here**2) - np.mean(there**2))

    def beside(self, new: Sequence[Comparison]) -> tuple[Comparison, ...]:
        """Return new runs beside the reading of a healthy vehicle."""
        read = [replace(r, phi_predicted=self.regressors(r) @ self.weights) for r in new]
        return tuple(map(self.spread.held, read))


@dataclass(frozen=True, slots=True)
class Spread:
    """The healthy error's size: it grows with the reading's distance from its middle and slope."""

    middle: float
    floor: FloatArray  # (2,) of distance and slope, below which both count as this
    weights: FloatArray  # (3,) of the logarithm

    @classmethod
    def of(cls, healthy: Sequence[Comparison]) -> "Spread":
        """Return the spread of runs beside a reading that did not see them."""
        middle = float(np.median(np.concatenate([r.phi_predicted[r.scored] for r in healthy])))
        error = np.concatenate([r.residual[r.scored] for r in healthy])
        about = [_about(r, middle)[r.scored] for r in healthy]
        floor = np.median(np.concatenate(about), axis=0) + 1e-12
        first = cls(middle, floor, np.zeros(3))
        design = np.concatenate([first._design(x) for x in about])
        least = max(float(np.median(np.abs(error))), 1e-12)
        wanted = 0.5 * np.log(error**2 + (0.3 * least) ** 2)
        weights = np.linalg.lstsq(design, wanted, rcond=None)[0]
        weights[0] += np.log(1.4826 * np.median(np.abs(error) / np.exp(design @ weights)))
        return cls(middle, floor, weights)

    def __call__(self, run: Comparison) -> FloatArray:
        """Return the spread (n,) of a run beside the healthy reading, in the output's unit."""
        return np.asarray(np.exp(self._design(_about(run, self.middle)) @ self.weights))

    def held(self, run: Comparison) -> Comparison:
        """Return the run with errors beyond the largest held at it."""
        most = LARGEST * self(run)
        error = np.clip(run.phi_measured - run.phi_predicted, -most, most)
        return replace(run, phi_measured=run.phi_predicted + error)

    def _design(self, about: FloatArray) -> FloatArray:
        return np.column_stack([np.ones(len(about)), np.log(about + self.floor)])


def _about(run: Comparison, middle: float) -> FloatArray:
    """Return the reading's distance from the middle and its slope (n, 2), over a second or so."""
    steep = np.abs(rate(run.phi_predicted, run.period_s))
    both = (np.abs(run.phi_predicted - middle), steep)
    return np.column_stack([np.maximum(lag(x, ABOUT_S, run.period_s), x) for x in both])


def _fit(
    tables: Sequence[FloatArray], targets: Sequence[FloatArray], runs: Sequence[Comparison]
) -> tuple[list[FloatArray], FloatArray]:
    """Return each run's prediction by a fit to the others, and the weights of the fit to all."""
    rows = [t[r.scored] for t, r in zip(tables, runs, strict=True)]
    wanted = [y[r.scored] for y, r in zip(targets, runs, strict=True)]
    grams = np.array([x.T @ x for x in rows])
    rights = np.array([x.T @ y for x, y in zip(rows, wanted, strict=True)])
    scale = np.sqrt(np.maximum(np.diagonal(grams.sum(0)), 1e-12))
    grams /= scale[:, None] * scale
    rights /= scale
    tried = list[tuple[float, float, list[FloatArray]]]()
    for penalty in PENALTIES:
        each = [
            solve(grams.sum(0) - g, rights.sum(0) - b, penalty) / scale
            for g, b in zip(grams, rights, strict=True)
        ]
        lost = sum(
            float(((y - x @ w) ** 2).sum()) for x, y, w in zip(rows, wanted, each, strict=True)
        )
        tried.append((lost, penalty, each))
    _, penalty, best = min(tried, key=lambda of: of[0])
    whole = solve(grams.sum(0), rights.sum(0), penalty) / scale
    return [t @ w for t, w in zip(tables, best, strict=True)], whole


def solve(gram: FloatArray, right: FloatArray, penalty: float = RIDGE) -> FloatArray:
    """Return the weights (k,) of normal equations with a ridge; 0 where nothing moves."""
    k, size = len(right), float(np.trace(gram))
    if size < NOTHING:
        return np.zeros(k)
    return np.asarray(np.linalg.solve(gram + penalty * size / k * np.eye(k), right))
