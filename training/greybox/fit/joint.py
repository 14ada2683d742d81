"""The joint fit: constants of the chain and of effects to several drives, in whitened errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise, product
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from monitor.base.types import FloatArray, IntArray
from training.greybox.chain import RANGES, Constants
from training.greybox.effects import Effect, Parameter
from training.greybox.effects.model_effect import Effects, ModelEffect
from training.greybox.fit.case import Case, Term, judged, plain_errors, predict, white
from training.greybox.fit.drive import FOLDS

LOW: Final = np.array([RANGES[name].low for name in Constants._fields])
HIGH: Final = np.array([RANGES[name].high for name in Constants._fields])
STEP: Final = 1e-4  # of a scale, for derivatives
Values = Sequence[float] | FloatArray
INSIDE: Final = 1e-6  # of the range: distance from a bound at which a fit starts


@dataclass(frozen=True, slots=True)
class JointSearch:
    """How far a fit looks for the base constants, and when it ends."""

    scale: Constants  # typical step
    tolerance: float  # relative, of cost and constants, at which a fit ends
    steps_most: int


_NEARBY: Final = Constants(
    gain=0.01, dead_time_s=0.02, dead_time_revolutions=0.2, mixing_s=0.02, sensor_s=0.02, span=0.02
)
NEARBY: Final = JointSearch(_NEARBY, 1e-5, 40)


@dataclass(frozen=True, slots=True)
class JointFit:
    """One fitted model."""

    terms: tuple[Term, ...]
    base: Constants
    parameters: tuple[FloatArray, ...]  # per term
    residual: FloatArray  # (m,) whitened, in sigma, kept samples of all drives
    jacobian: FloatArray  # (m, p)
    hessian: FloatArray  # (p, p) with the prior; first the base, unless it is fixed
    cost: float  # half the sum of squares, with the prior

    @property
    def standard_errors(self) -> tuple[FloatArray, ...]:
        """One standard error of each term's parameters."""
        spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(self.hessian)), 0.0))
        own = [len(p) for p in self.parameters]
        sizes = np.cumsum([len(spread) - sum(own), *own])
        return tuple(spread[a:b] for a, b in pairwise(sizes))

    @property
    def effects(self) -> Effects:
        """Its effects with their values and standard errors."""
        terms = zip(self.terms, self.parameters, self.standard_errors, strict=True)
        return tuple(
            ModelEffect.with_values(term.name, values.tolist(), errors.tolist())
            for term, values, errors in terms
            if isinstance(term, Effect)
        )


def fit(
    case: Case,
    terms: Sequence[Term],
    starts: Sequence[JointFit | Constants],
    search: JointSearch = NEARBY,
) -> JointFit:
    """Return the best fit over all starts.

    starts : base constants, or a fit of some of the terms, the first ones. The parameters of the
    other terms start at all combinations of their starts.
    """
    layout = ParameterLayout(case, tuple(terms))
    different = dict[tuple[float, ...], None]()  # in their order
    for start in starts:
        base, own = (start.base, start.parameters) if isinstance(start, JointFit) else (start, ())
        grids = [product(*(p.start for p in term.parameters)) for term in terms[len(own) :]]
        points = (layout.join(base, [*own, *values]) for values in product(*grids))
        different |= dict.fromkeys(tuple(x.tolist()) for x in points)
    return min((_descend(layout, np.array(x), search) for x in different), key=lambda f: f.cost)


@dataclass(frozen=True)
class ParameterLayout:
    """The moving constants of a fit in one array."""

    case: Case
    terms: tuple[Term, ...]

    def split(self, x: FloatArray) -> tuple[Constants, list[FloatArray]]:
        """Return the base and each term's parameters."""
        fixed = self.case.fixed
        first = 0 if fixed else len(LOW)
        sizes = np.cumsum([first, *(len(term.parameters) for term in self.terms)])
        base = fixed or Constants(*x[:first].tolist())
        return base, [x[a:b] for a, b in pairwise(sizes)]

    def join(self, of_base: Values, of_terms: Sequence[Values]) -> FloatArray:
        """Return the array for the base's values and each term's values."""
        return np.concatenate([*([[]] if self.case.fixed else [of_base]), *of_terms])

    def of_each(self, of_base: Values, of: Callable[[Parameter], float]) -> FloatArray:
        """Return the array for the base's values and what ``of`` says of each term's constants."""
        return self.join(of_base, [[of(p) for p in term.parameters] for term in self.terms])

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest constants."""
        return self.of_each(LOW, lambda p: p.low), self.of_each(HIGH, lambda p: p.high)

    def white(self, x: FloatArray) -> list[FloatArray]:
        """Return the white errors of each drive, then those of the prior and of the terms."""
        base, own = self.split(x)
        of_drives = white(self.case, predict(self.case, base, self.terms, own))
        mean, spread = self._expected
        return [*of_drives, ((x - mean) / spread)[np.isfinite(spread)]]

    @cached_property
    def _expected(self) -> tuple[FloatArray, FloatArray]:
        """Mean and spread of the constants, infinite where any value may be."""
        mean, spread = self.case.prior or (Constants(), np.full(len(LOW), np.inf))
        means = self.of_each(mean, lambda p: p.start[0])
        return means, self.of_each(spread, lambda p: p.spread or np.inf)

    def slopes(
        self, x: FloatArray, at: Sequence[FloatArray], steps: FloatArray
    ) -> list[FloatArray]:
        """Return the derivatives (m, p) of each part of ``white``, which is ``at`` at ``x``."""
        rows = []
        for i, step in enumerate(np.where(x + steps < self.limits[1], steps, -steps).tolist()):
            moved = x.copy()
            moved[i] += step
            pairs = zip(self.white(moved), at, strict=True)
            rows.append([(after - before) / step for after, before in pairs])
        return [np.array(own).T for own in zip(*rows, strict=True)]

    def judged(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return the parts of ``white``, or their slopes, as errors in sigma."""
        *of_drives, rows = parts
        return np.concatenate([judged(self.case, of_drives), rows])


def _descend(layout: ParameterLayout, x: FloatArray, search: JointSearch) -> JointFit:
    low, high = layout.limits
    scale = layout.of_each(search.scale, lambda p: max(map(abs, p.start)))

    @lru_cache(1)  # a slope is asked for where an error was
    def white(at: tuple[float, ...]) -> list[FloatArray]:
        return layout.white(np.array(at))

    def slope(x: FloatArray) -> FloatArray:
        return layout.judged(layout.slopes(x, white(tuple(x)), STEP * scale))

    def error(x: FloatArray) -> FloatArray:
        return layout.judged(white(tuple(x)))

    if len(x):
        margin = INSIDE * (high - low)
        found = least_squares(
            error,
            np.clip(x, low + margin, high - margin),
            slope,
            (low, high),
            x_scale=scale,
            ftol=search.tolerance,
            xtol=search.tolerance,
            max_nfev=search.steps_most,
        )
        x, e, cost = found.x, found.fun, float(found.cost)
        jacobian = np.asarray(found.jac, dtype=np.float64)
    else:
        e = error(x)
        jacobian, cost = np.empty((len(e), 0)), float(e @ e) / 2.0
    base, own = layout.split(x)
    m = sum(map(len, layout.case.rows))
    return JointFit(
        terms=layout.terms,
        base=base,
        parameters=tuple(own),
        residual=e[:m],
        jacobian=jacobian[:m],
        hessian=jacobian.T @ jacobian,
        cost=cost,
    )


def held_out(found: JointFit, blocks: IntArray) -> FloatArray:
    """Return each sample's error (m,) in sigma by the fit without the fold of its block.

    The fit without a fold is one Gauss-Newton step away from the whole fit, which is enough for a
    dozen constants and thousands of samples.
    """
    fold = blocks % FOLDS
    steps = np.array(_steps_without(found, fold))
    return np.asarray(found.residual + (found.jacobian * steps[fold]).sum(axis=1))


def held_out_rmse(case: Case, found: JointFit) -> float:
    """Return the RMSE in phi over all blocks, each predicted by the fit without its fold."""
    fold = case.blocks % FOLDS
    layout = ParameterLayout(case, found.terms)
    low, high = layout.limits
    centre = layout.join(found.base, found.parameters)
    squares = 0.0
    for f, step in enumerate(_steps_without(found, fold)):
        base, own = layout.split(np.clip(centre + step, low, high))
        e = plain_errors(case, predict(case, base, found.terms, own))
        squares += float((e[fold == f] ** 2).sum())
    return float(np.sqrt(squares / len(fold)))


def _steps_without(found: JointFit, fold: IntArray) -> list[FloatArray]:
    """Return the step of the constants (p,) for each fold that is left out."""
    steps = []
    for f in range(FOLDS):
        own = found.jacobian[fold == f]
        rest = found.hessian - own.T @ own
        ridge = 1e-9 * np.diag(np.diag(found.hessian) + 1e-12)
        steps.append(np.linalg.solve(rest + ridge, own.T @ found.residual[fold == f]))
    return steps
