"""The fit of the tables: Gauss-Newton on whitened residuals with the laws' priors.

The residual of the mixture is coloured by combustion, by the air's slow error and by lines, so an
autoregressive filter of the residual whitens it; the filter is estimated anew in each step. Samples
count less where the mixture moves far, because an error of timing is then large, and where a
residual is an outlier. The uncertainty is that of blocks of samples (White's sandwich), so it
holds when the residual is not quite white.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import BoolArray, FloatArray
from training.ecu_tables.balance import balance
from training.ecu_tables.fields import KNOTS, grid_over
from training.ecu_tables.parameters import SCALARS, Parameters
from training.ecu_tables.prediction import PredictionCase, reading, sensitivities
from training.ecu_tables.signals import TableSubject

AR_S: Final = 0.5  # length of the whitening filter
AR_MOST: Final = 12
MOVE_SCALE: Final = 0.15  # phi: a move at which a sample's weight is halved
AIR_MOVE_SCALE: Final = 0.3  # logarithm of the air, the same
OUTLIER: Final = 3.0  # sigma
STEPS: Final = 15
PIPES_S: Final = (0.02, 0.1, 0.4)  # starts: time in the pipe at the median flow
PARTS: Final = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step that are tried
BLOCK_S: Final = 15.0
GAIN_LEAST: Final = 0.05  # of the logarithm of the likelihood that a further step should gain
ROUGH_KNOTS: Final = 2
ROUGH_STEPS: Final = 6
ROUGH_SHARE: Final = 0.4  # of the time
FILM_LOG_ODDS: Final = (-1.5, -4.0)  # starts: a wet wall and a dry one

Report = Callable[[float, float], None]  # share done, scale of the residual in phi


@dataclass(frozen=True, slots=True)
class FittedTables:
    """Parameters of the tables with their covariance."""

    parameters: Parameters
    x: FloatArray
    covariance: FloatArray  # (size, size)
    sigma: float  # of the whitened residual in phi
    cases: tuple[PredictionCase, ...]
    alone: tuple["FittedTables", ...] = ()  # the same of each log, or of the halves of a single one


@dataclass(frozen=True, slots=True)
class _Noise:
    """Whitening filter and scale of the residual."""

    filter: FloatArray  # (order * every + 1,), first is 1, 0 between updates of the reading
    sigma: float

    @staticmethod
    def of(own: FloatArray, every: int) -> "_Noise":
        """Return the noise whose value follows from (order,) of its earlier ones, so far apart."""
        spread = np.zeros((len(own), every))
        spread[:, -1] = -own
        return _Noise(np.concatenate([[1.0], spread.ravel()]), 1.0)

    def kept(self, usable: BoolArray) -> BoolArray:
        """Return the samples whose whole filter lies on usable ones."""
        taps = (self.filter != 0.0).astype(float)
        return np.asarray(lfilter(taps, [1.0], usable.astype(float)) > taps.sum() - 0.5)


def fit(subject: TableSubject, report: Report = lambda _share, _sigma: None) -> FittedTables:
    """Return the fit of all tables of one vehicle, and the same fit of each log alone.

    report : is told the share done, 0 to 1, and the scale of the whitened residual in phi
    """
    logs = subject.logs()
    share = 1.0 / (1 + len(logs))
    parts = [_part(report, k * share, (k + 1) * share) for k in range(1 + len(logs))]
    alone = tuple(_fit(log, part) for log, part in zip(logs, parts[1:], strict=True))
    return replace(_fit(subject, parts[0]), alone=alone)


def _fit(subject: TableSubject, report: Report) -> FittedTables:
    first = _rough(subject, report)
    p = _parameters(subject, KNOTS)
    cases = tuple(PredictionCase.of(d, p) for d in subject.drives)
    x = p.mean()
    x[: len(SCALARS)] = first[: len(SCALARS)]
    x, noise = _descent(p, x, cases, STEPS, _part(report, ROUGH_SHARE, 1.0))
    prior = p.precision()
    normal, _, blocks = _equations(p, x, cases, noise)
    inverse = np.linalg.inv(normal + prior)
    report(1.0, noise.sigma)
    return FittedTables(p, x, inverse @ (blocks + prior) @ inverse, noise.sigma, cases)


def _part(report: Report, begin: float, end: float) -> Report:
    """Return the report of a part of the work, whose share runs from ``begin`` to ``end``."""
    return lambda done, sigma: report(begin + (end - begin) * done, sigma)


def _rough(subject: TableSubject, report: Report) -> FloatArray:
    """Return the likeliest start after a few steps on a coarse grid and the longest drive.

    A wet and a dry wall and short and long pipes explain a drive nearly alike from afar, and the
    descent does not cross from one to the other.
    """
    p = _parameters(subject, ROUGH_KNOTS)
    longest = max(subject.drives, key=lambda d: int(d.usable.sum()))
    cases = (PredictionCase.of(longest, p),)
    flow = float(np.median(cases[0].point.flow_kg_h[longest.usable]))
    starts = [(film, pipe_s) for film in FILM_LOG_ODDS for pipe_s in PIPES_S]
    share = ROUGH_SHARE / len(starts)
    found = []
    for k, (film, pipe_s) in enumerate(starts):
        x = p.mean()
        x[p.at["film"]], x[p.at["delay_flow"]] = film, np.log(pipe_s * flow)
        x, noise = _descent(p, x, cases, ROUGH_STEPS, _part(report, k * share, (k + 1) * share))
        off = x - p.mean()
        cost = _deviance(p, x, cases, noise) + 0.5 * float(off @ p.precision() @ off)
        found.append((cost, x))
    return min(found, key=lambda costed: costed[0])[1]


def _parameters(subject: TableSubject, knots: int) -> Parameters:
    rpm = [d.rpm[d.usable] for d in subject.drives]
    p = Parameters(subject, grid_over(rpm, [d.load[d.usable] for d in subject.drives], knots))
    return replace(p, fuel=balance(p))


def _descent(
    p: Parameters, x: FloatArray, cases: tuple[PredictionCase, ...], steps: int, report: Report
) -> tuple[FloatArray, _Noise]:
    """Return the parameters after at most so many Gauss-Newton steps, and the noise at them."""
    prior = p.precision()
    noise = _noise(p, x, cases)
    for k in range(steps):
        normal, slope, _ = _equations(p, x, cases, noise)
        downhill = slope - prior @ (x - p.mean())
        step = np.asarray(np.linalg.solve(normal + prior, downhill), float)
        if step @ downhill < GAIN_LEAST:
            break
        x = _descend(p, x, step=step, cases=cases, noise=noise, prior=prior)
        noise = _noise(p, x, cases)
        report((k + 1) / steps, noise.sigma)
    return x, noise


def _deviance(
    p: Parameters, x: FloatArray, cases: tuple[PredictionCase, ...], noise: _Noise
) -> float:
    """Return minus the logarithm of the likelihood, comparable between scales of the noise."""
    number = sum(int(noise.kept(c.drive.usable).sum()) for c in cases)
    return _cost(p, x, cases, noise) + number * float(np.log(noise.sigma))


def _scale(case: PredictionCase) -> FloatArray:
    d = case.drive
    return 1.0 + (d.move / MOVE_SCALE) ** 2 + (d.air_move / AIR_MOVE_SCALE) ** 2


def _noise(p: Parameters, x: FloatArray, cases: tuple[PredictionCase, ...]) -> _Noise:
    """Return the whitening filter of the residuals by weighted least squares."""
    every = max(c.drive.every for c in cases)
    order = min(max(round(AR_S / cases[0].drive.period_s / every), 2), AR_MOST)
    normal, slope = np.zeros((order, order)), np.zeros(order)
    for case in cases:
        e = case.drive.phi - reading(p, x, case)
        at = np.flatnonzero(_Noise.of(np.ones(order), every).kept(case.drive.usable))
        late = np.stack([e[at - k * every] for k in range(1, order + 1)], axis=1)
        w = _scale(case)[at] ** -2.0
        normal += late.T @ (late * w[:, None])
        slope += late.T @ (e[at] * w)
    plain = _Noise.of(
        np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(order), slope), every
    )
    white = np.concatenate([_white(p, x, c, plain)[plain.kept(c.drive.usable)] for c in cases])
    return replace(plain, sigma=float(1.4826 * np.median(np.abs(white))))


def _white(p: Parameters, x: FloatArray, case: PredictionCase, noise: _Noise) -> FloatArray:
    e = case.drive.phi - reading(p, x, case)
    return np.asarray(lfilter(noise.filter, [1.0], e) / _scale(case) / noise.sigma)


def _cost(p: Parameters, x: FloatArray, cases: tuple[PredictionCase, ...], noise: _Noise) -> float:
    """Return the robust cost: half the squares, growing slowly beyond three sigma."""
    total = 0.0
    for case in cases:
        white = _white(p, x, case, noise)[noise.kept(case.drive.usable)]
        total += float(np.log1p((white / OUTLIER) ** 2).sum()) * OUTLIER**2 / 2.0
    return total


def _equations(
    p: Parameters, x: FloatArray, cases: tuple[PredictionCase, ...], noise: _Noise
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
    cases: tuple[PredictionCase, ...],
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
