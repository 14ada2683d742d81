"""The fit of the tables: Gauss-Newton on whitened residuals with the laws' priors.

The residual of the mixture is coloured by combustion, by the air's slow error and by lines, so an
autoregressive filter of the residual whitens it; the filter is estimated anew in each step. Samples
count less where the mixture moves far, because an error of timing is then large, and where a
residual is an outlier. The uncertainty is that of blocks of samples (White's sandwich), so it
holds when the residual is not quite white.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import BoolArray, FloatArray
from training.ecu_tables.balance import balance
from training.ecu_tables.parameters import KNOTS, SCALARS, Parameters, Vector, grid_over
from training.ecu_tables.prediction import PredictionCase, reading
from training.ecu_tables.signals import TableDrive, TableSubject
from training.greybox.fit.constants import Report, nobody, part

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


def fit(subject: TableSubject, report: Report = nobody) -> FittedTables:
    """Return the fit of all tables of one vehicle, and the same fit of each log alone.

    report : is told the share done, 0 to 1, and the scale of the whitened residual in phi
    """
    of = [subject, *subject.logs()]
    parts = (part(report, k / len(of), (k + 1) / len(of)) for k in range(len(of)))
    whole, *alone = map(_fit, of, parts)
    return replace(whole, alone=tuple(alone))


def _fit(subject: TableSubject, report: Report) -> FittedTables:
    first = _rough(subject, report)
    problem = _Problem.of(subject, subject.drives, KNOTS)
    x = problem.p.mean()
    x[: len(SCALARS)] = first[: len(SCALARS)]
    x, noise = problem.descent(x, STEPS, part(report, ROUGH_SHARE, 1.0))
    normal, _, blocks = problem.equations(x, noise)
    inverse, prior = np.linalg.inv(normal + problem.prior), problem.prior
    covariance = inverse @ (blocks + prior) @ inverse
    report(1.0, noise.sigma)
    return FittedTables(problem.p, x, covariance, noise.sigma, problem.cases)


def _rough(subject: TableSubject, report: Report) -> FloatArray:
    """Return the likeliest start after a few steps on a coarse grid and the longest drive.

    A wet and a dry wall and short and long pipes explain a drive nearly alike from afar, and the
    descent does not cross from one to the other.
    """
    longest = max(subject.drives, key=lambda d: int(d.usable.sum()))
    problem = _Problem.of(subject, [longest], ROUGH_KNOTS)
    p, flow_kg_h = problem.p, problem.cases[0].point.flow_kg_h
    flow = float(np.median(flow_kg_h[longest.usable]))
    starts = [(film, pipe_s) for film in FILM_LOG_ODDS for pipe_s in PIPES_S]
    share = ROUGH_SHARE / len(starts)
    found = []
    for k, (film, pipe_s) in enumerate(starts):
        x = p.mean()
        x[p.at["film"]], x[p.at["delay_flow"]] = film, np.log(pipe_s * flow)
        x, noise = problem.descent(x, ROUGH_STEPS, part(report, k * share, (k + 1) * share))
        number = sum(int(noise.kept(c.drive.usable).sum()) for c in problem.cases)
        deviance = problem.cost(x, noise) + number * float(np.log(noise.sigma))
        found.append((deviance, x))  # comparable between scales of the noise
    return min(found, key=lambda costed: costed[0])[1]


@dataclass(frozen=True)
class _Problem:
    """The parameters that some drives are to tell."""

    p: Parameters
    cases: tuple[PredictionCase, ...]

    @classmethod
    def of(cls, subject: TableSubject, drives: Sequence[TableDrive], knots: int) -> "_Problem":
        """Return the problem with a grid over all drives of the subject."""
        rpm = np.concatenate([d.rpm[d.usable] for d in subject.drives])
        load = np.concatenate([d.load[d.usable] for d in subject.drives])
        p = Parameters(subject, grid_over(rpm, load, knots))
        p = replace(p, fuel=balance(p))
        return cls(p, tuple(PredictionCase.of(d, p) for d in drives))

    @cached_property
    def prior(self) -> FloatArray:
        """The inverse of the prior's covariance."""
        return self.p.precision()

    def descent(self, x: FloatArray, steps: int, report: Report) -> tuple[FloatArray, _Noise]:
        """Return the parameters after at most so many Gauss-Newton steps, and the noise there."""
        noise = self.noise(x)
        for k in range(steps):
            normal, slope, _ = self.equations(x, noise)
            downhill = slope - self.prior @ (x - self.p.mean())
            step = np.asarray(np.linalg.solve(normal + self.prior, downhill), float)
            if step @ downhill < GAIN_LEAST:
                break
            before = self.cost(x, noise)  # the largest part of the step that lowers it is taken
            moves = (x + size * step for size in PARTS)
            x = next((moved for moved in moves if self.cost(moved, noise) < before), x)
            noise = self.noise(x)
            report((k + 1) / steps, noise.sigma)
        return x, noise

    def noise(self, x: FloatArray) -> _Noise:
        """Return the whitening filter of the residuals by weighted least squares."""
        every = math.lcm(*(c.drive.every for c in self.cases))
        order = min(max(round(AR_S / self.cases[0].drive.period_s / every), 2), AR_MOST)
        errors, rows = self.errors(x), []
        for case, e in zip(self.cases, errors, strict=True):
            at = np.flatnonzero(_Noise.of(np.ones(order), every).kept(case.drive.usable))
            late = [e[at - k * every] for k in range(order + 1)]
            rows.append(np.stack(late, axis=1) / _scale(case)[at, None])
        now, *past = np.concatenate(rows).T
        plain = _Noise.of(np.linalg.lstsq(np.array(past).T, now)[0], every)
        return replace(plain, sigma=float(1.4826 * np.median(np.abs(self._white(errors, plain)))))

    def errors(self, x: FloatArray) -> list[FloatArray]:
        """Return the residuals (n,) of each drive in phi."""
        return [c.drive.phi - reading(Vector(self.p, x), c) for c in self.cases]

    def _white(self, errors: Sequence[FloatArray], noise: _Noise) -> FloatArray:
        """Return the whitened residuals (m,) of all drives' samples that count."""
        pairs = zip(self.cases, errors, strict=True)
        white = [(c, lfilter(noise.filter, [1.0], e) / _scale(c) / noise.sigma) for c, e in pairs]
        return np.concatenate([own[noise.kept(c.drive.usable)] for c, own in white])

    def cost(self, x: FloatArray, noise: _Noise) -> float:
        """Return half the squares, growing slowly beyond three sigma, with those of the prior."""
        off, white = x - self.p.mean(), self._white(self.errors(x), noise)
        squares = float(np.log1p((white / OUTLIER) ** 2).sum()) * OUTLIER**2
        return 0.5 * (squares + float(off @ self.prior @ off))

    def equations(self, x: FloatArray, noise: _Noise) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the normal matrix, the slope, and the sum of squares of the blocks' slopes."""
        size = self.p.size
        normal, slope, squares = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
        for case in self.cases:
            scale = _scale(case)[:, None] * noise.sigma
            read = reading(Vector(self.p, x, moving=True), case)
            jacobian = lfilter(noise.filter, [1.0], self.p.jacobian(read), axis=0) / scale
            white = lfilter(noise.filter, [1.0], case.drive.phi - read.value) / scale[:, 0]
            w = noise.kept(case.drive.usable) / (1.0 + (white / OUTLIER) ** 2)
            weighted = jacobian * w[:, None]
            normal += jacobian.T @ weighted
            gradient = weighted * white[:, None]
            slope += gradient.sum(axis=0)
            starts = np.arange(0, len(white), round(BLOCK_S / case.drive.period_s) or 1)
            sums = np.add.reduceat(gradient, starts, axis=0)
            squares += sums.T @ sums
        return normal, slope, squares


def _scale(case: PredictionCase) -> FloatArray:
    d = case.drive
    return 1.0 + (d.move / MOVE_SCALE) ** 2 + (d.air_move / AIR_MOVE_SCALE) ** 2
