"""The fit of the tables: Gauss-Newton on whitened residuals with the laws' priors.

The residual of the mixture is coloured by combustion, by the air's slow error and by lines, so an
autoregressive filter of the residual whitens it; the filter is estimated anew in each step. Samples
count less where the mixture moves far, because an error of timing is then large, and where a
residual is an outlier. The uncertainty is that of blocks of samples (White's sandwich), so it
holds when the residual is not quite white.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import BoolArray, FloatArray
from training.ecu_tables.fields import grid_over
from training.ecu_tables.parameters import Parameters
from training.ecu_tables.prediction import Case, reading, sensitivities
from training.ecu_tables.signals import Subject

AR_S: Final = 0.5  # length of the whitening filter
AR_MOST: Final = 12
MOVE_SCALE: Final = 0.15  # phi: a move at which a sample's weight is halved
AIR_MOVE_SCALE: Final = 0.3  # logarithm of the air, the same
OUTLIER: Final = 3.0  # sigma
STEPS: Final = 15
DELAYS_S: Final = (0.08, 0.15, 0.25, 0.4, 0.6, 0.9)  # starts, at the median flow
PARTS: Final = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step that are tried
BLOCK_S: Final = 15.0
TOLERANCE: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Fitted:
    """Parameters of the tables with their covariance."""

    parameters: Parameters
    x: FloatArray
    covariance: FloatArray  # (size, size)
    sigma: float  # of the whitened residual in phi
    cases: tuple[Case, ...]


@dataclass(frozen=True, slots=True)
class _Noise:
    """Whitening filter and scale of the residual."""

    filter: FloatArray  # (order + 1,), first is 1
    sigma: float

    def kept(self, usable: BoolArray) -> BoolArray:
        """Return the samples whose whole filter lies on usable ones."""
        return np.asarray(
            lfilter(np.ones(len(self.filter)), [1.0], usable.astype(float)) > len(self.filter) - 0.5
        )


def fit(subject: Subject) -> Fitted:
    """Return the fit of all tables of one vehicle."""
    p = Parameters(
        subject,
        grid_over(
            [d.rpm[d.usable] for d in subject.drives], [d.load[d.usable] for d in subject.drives]
        ),
    )
    cases = tuple(Case.of(d, p) for d in subject.drives)
    x = _start(p, cases)
    prior = p.precision()
    noise = _noise(p, x, cases)
    for _ in range(STEPS):
        normal, slope, _ = _equations(p, x, cases, noise)
        step = np.asarray(np.linalg.solve(normal + prior, slope - prior @ (x - p.mean())), float)
        x = _descend(p, x, step=step, cases=cases, noise=noise, prior=prior)
        noise = _noise(p, x, cases)
        if np.abs(step).max() < TOLERANCE:
            break
    normal, _, blocks = _equations(p, x, cases, noise)
    inverse = np.linalg.inv(normal + prior)
    return Fitted(p, x, inverse @ (blocks + prior) @ inverse, noise.sigma, cases)


def _start(p: Parameters, cases: tuple[Case, ...]) -> FloatArray:
    """Return the start: the gain by the median, the delay by the best of a few."""
    best, least = p.mean(), np.inf
    flow = np.median(np.concatenate([c.point.flow_kg_h[c.drive.usable] for c in cases]))
    for seconds in DELAYS_S:
        x = p.mean()
        x[p.at["delay_flow"]] = np.log(seconds * flow)
        for _ in range(2):
            ratio = [np.median(reading(p, x, c) / np.maximum(c.drive.phi, 0.1)) for c in cases]
            x[p.at["flow"]] -= np.log(np.median(ratio))
        cost = _cost(p, x, cases, _noise(p, x, cases))
        if cost < least:
            best, least = x, cost
    return best


def _scale(case: Case) -> FloatArray:
    d = case.drive
    return 1.0 + (d.move / MOVE_SCALE) ** 2 + (d.air_move / AIR_MOVE_SCALE) ** 2


def _noise(p: Parameters, x: FloatArray, cases: tuple[Case, ...]) -> _Noise:
    """Return the whitening filter of the residuals by weighted least squares."""
    order = min(max(round(AR_S / cases[0].drive.period_s), 2), AR_MOST)
    normal, slope = np.zeros((order, order)), np.zeros(order)
    for case in cases:
        e = case.drive.phi - reading(p, x, case)
        kept = _Noise(np.ones(order + 1), 1.0).kept(case.drive.usable)
        at = np.flatnonzero(kept)
        late = np.stack([e[at - k] for k in range(1, order + 1)], axis=1)
        w = _scale(case)[at] ** -2.0
        normal += late.T @ (late * w[:, None])
        slope += late.T @ (e[at] * w)
    a = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(order), slope)
    plain = _Noise(np.concatenate([[1.0], -a]), 1.0)
    white = np.concatenate([_white(p, x, c, plain)[plain.kept(c.drive.usable)] for c in cases])
    return _Noise(plain.filter, float(1.4826 * np.median(np.abs(white))))


def _white(p: Parameters, x: FloatArray, case: Case, noise: _Noise) -> FloatArray:
    e = case.drive.phi - reading(p, x, case)
    return np.asarray(lfilter(noise.filter, [1.0], e) / _scale(case) / noise.sigma)


def _cost(p: Parameters, x: FloatArray, cases: tuple[Case, ...], noise: _Noise) -> float:
    """Return the robust cost: half the squares, growing slowly beyond three sigma."""
    total = 0.0
    for case in cases:
        white = _white(p, x, case, noise)[noise.kept(case.drive.usable)]
        total += float(np.log1p((white / OUTLIER) ** 2).sum()) * OUTLIER**2 / 2.0
    return total


def _equations(
    p: Parameters, x: FloatArray, cases: tuple[Case, ...], noise: _Noise
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the normal matrix, the slope, and the sum of squares of the blocks' slopes."""
    normal, slope = np.zeros((p.size, p.size)), np.zeros(p.size)
    squares = np.zeros((p.size, p.size))
    for case in cases:
        kept = noise.kept(case.drive.usable)
        scale = _scale(case)[:, None] * noise.sigma
        base, jacobian = sensitivities(p, x, case)
        jacobian = lfilter(noise.filter, [1.0], jacobian, axis=0) / scale
        white = lfilter(noise.filter, [1.0], case.drive.phi - base) / scale[:, 0]
        w = kept / (1.0 + (white / OUTLIER) ** 2)
        weighted = jacobian * w[:, None]
        normal += jacobian.T @ weighted
        gradient = weighted * white[:, None]
        slope += gradient.sum(axis=0)
        size = round(BLOCK_S / case.drive.period_s)
        starts = np.arange(0, len(base), size)
        sums = np.add.reduceat(gradient, starts, axis=0)
        squares += sums.T @ sums
    return normal, slope, squares


def _descend(
    p: Parameters,
    x: FloatArray,
    step: FloatArray,
    cases: tuple[Case, ...],
    noise: _Noise,
    prior: FloatArray,
) -> FloatArray:
    """Return the parameters after the largest part of the step that lowers the cost."""

    def cost(y: FloatArray) -> float:
        off = y - p.mean()
        return _cost(p, y, cases, noise) + 0.5 * float(off @ prior @ off)

    before = cost(x)
    for size in PARTS:
        moved = x + size * step
        if cost(moved) < before:
            return moved
    return x
