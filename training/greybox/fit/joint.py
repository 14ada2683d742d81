"""The joint fit: constants of the chain and of effects to several drives, in whitened errors."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from monitor.base.types import BoolArray, FloatArray, IntArray
from training.greybox.chain import RANGES, Constants, Path, simulate
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.empirical import effect_of, is_empirical
from training.greybox.fit.comparison import BLOCK_S
from training.greybox.fit.drive import Drive, path_of
from training.greybox.fit.sensor_faults import FAULTS, SensorFault
from training.greybox.fit.variation import Shrink
from training.jobs.values import Named

Term = Effect | SensorFault
# Terms hold functions: a file of a run holds their names, see ``training.jobs.values``.
NAMED: Final[Named] = {
    Effect: lambda name: effect_of(name) if is_empirical(name) else LIBRARY[name],
    SensorFault: {fault.name: fault for fault in FAULTS}.__getitem__,
}
LOW: Final = np.array([RANGES[name].low for name in Constants._fields])
HIGH: Final = np.array([RANGES[name].high for name in Constants._fields])
STEP: Final = 1e-4  # of a scale, for derivatives
WHITE: Final = (0.9, 0.0)  # nearly differences: slow errors are left to the correction
INSIDE: Final = 1e-6  # of the range: distance from a bound at which a fit starts


@dataclass(frozen=True, slots=True)
class Search:
    """How far a fit looks for the base constants, and when it ends."""

    scale: Constants  # typical step
    tolerance: float  # relative, of cost and constants, at which a fit ends
    steps_most: int


NEARBY: Final = Search(
    Constants(
        gain=0.01,
        dead_time_s=0.02,
        dead_time_revolutions=0.2,
        mixing_s=0.02,
        sensor_s=0.02,
        span=0.02,
    ),
    1e-5,
    40,
)


@dataclass(frozen=True, slots=True)
class Prior:
    """Expected constants of the chain."""

    mean: Constants
    spread: Constants  # standard deviation


@dataclass(frozen=True, slots=True)
class Run:
    """The base on a drive, without any terms."""

    path: Path
    phi: FloatArray  # (n,) that the sensor reads

    @classmethod
    def of(cls, drive: Drive, base: Constants) -> "Run":
        """Return the run of a base on a drive."""
        path = path_of(drive, base)
        return cls(path, simulate(path, drive.period_s))


@dataclass(frozen=True, slots=True)
class Case:
    """Drives to explain and everything that a fit needs beside its starting values."""

    drives: tuple[Drive, ...]
    corrections: tuple[FloatArray, ...]  # per drive (n,) in phi: error of the base when healthy
    ar: tuple[float, float] = (0.0, 0.0)  # autoregression of the noise, newest first
    sigma: float = 1.0  # of the whitened noise, in phi
    prior: Prior | None = None
    fixed: Constants | None = None  # of the base; a fit then moves the terms' parameters only
    shrinks: tuple[Shrink, ...] = ()  # per drive; empty if the variation of drives is unknown
    scales: tuple[float, ...] = ()  # per drive, of its errors, in sigma; empty if all are 1

    kept: tuple[BoolArray, ...] = field(init=False)  # per drive (n,), see ``Drive.kept``
    runs: tuple[Run, ...] = field(init=False)  # per drive, of a fixed base

    def __post_init__(self) -> None:
        fixed = self.fixed
        runs = () if fixed is None else tuple(Run.of(drive, fixed) for drive in self.drives)
        object.__setattr__(self, "kept", tuple(drive.kept for drive in self.drives))
        object.__setattr__(self, "runs", runs)

    @property
    def blocks(self) -> IntArray:
        """The block of each kept sample, (m,), numbered through all drives."""
        numbers, first = [], 0
        for drive, kept in zip(self.drives, self.kept, strict=True):
            of = np.arange(len(drive)) // round(BLOCK_S / drive.period_s)
            numbers.append(of[kept] + first)
            first += int(of[-1]) + 1
        _, compact = np.unique(np.concatenate(numbers), return_inverse=True)
        return np.asarray(compact, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Fit:
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


def has_its_signs(term: Term, values: FloatArray) -> bool:
    """Whether all parameters of a term that must be above 0 are above 0."""
    return all(v > 0.0 for p, v in zip(term.parameters, values, strict=True) if p.positive)


def predict(
    case: Case, base: Constants, terms: Sequence[Term], parameters: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return the predicted reading of the sensor, per drive (n,) in phi."""
    runs = case.runs if base == case.fixed else (None,) * len(case.drives)
    return [
        reading(drive, base, terms=terms, parameters=parameters, correction=correction, run=run)
        for drive, correction, run in zip(case.drives, case.corrections, runs, strict=True)
    ]


def reading(
    drive: Drive,
    base: Constants,
    terms: Sequence[Term],
    parameters: Sequence[FloatArray],
    correction: FloatArray | float = 0.0,
    run: Run | None = None,
) -> FloatArray:
    """Return the chain's phi (n,) with effects on the path and sensor faults after the chain.

    correction : (n,) in phi, from the chain to the reading of a healthy sensor
    run : of the base on the drive, computed by default
    """
    path = run.path if run else path_of(drive, base)
    for term, values in zip(terms, parameters, strict=True):
        if isinstance(term, Effect):
            path = term.apply(path, values, drive.signals, drive.period_s)
    read = run.phi if run and path is run.path else simulate(path, drive.period_s)
    phi = read + correction
    for term, values in zip(terms, parameters, strict=True):
        if isinstance(term, SensorFault):
            phi = term.read(phi, values, drive.period_s)
    return phi


def errors(case: Case, phi: Sequence[FloatArray]) -> FloatArray:
    """Return prediction minus measurement on the kept samples, whitened, in sigma: (m,)."""
    return _judged(case, _white(case, phi))


def _white(case: Case, phi: Sequence[FloatArray]) -> list[FloatArray]:
    """Return each drive's errors on its kept samples, whitened, before drives' differences."""
    a, b = case.ar
    parts = []
    for drive, predicted, kept in zip(case.drives, phi, case.kept, strict=True):
        e = predicted - drive.phi_measured
        e[2:] = e[2:] - a * e[1:-1] - b * e[:-2]
        parts.append(e[kept] / case.sigma)
    return parts


def _judged(case: Case, parts: Sequence[FloatArray]) -> FloatArray:
    """Return white errors of all drives by how drives differ: of (m,) or (m, k) per drive."""
    if case.shrinks:
        parts = [shrink.apply(part) for shrink, part in zip(case.shrinks, parts, strict=True)]
    if case.scales:
        parts = [part / scale for scale, part in zip(case.scales, parts, strict=True)]
    return np.concatenate(parts)


def plain_errors(case: Case, phi: Sequence[FloatArray]) -> FloatArray:
    """Return prediction minus measurement on the kept samples in phi, (m,)."""
    parts = zip(phi, case.drives, case.kept, strict=True)
    return np.concatenate([(each - drive.phi_measured)[kept] for each, drive, kept in parts])


def fit(
    case: Case,
    terms: Sequence[Term],
    starts: Sequence[Fit | Constants],
    search: Search = NEARBY,
) -> Fit:
    """Return the best fit over all starts.

    starts : base constants, or a fit of some of the terms, the first ones. The parameters of the
    other terms start at all combinations of their starts.
    """
    best: Fit | None = None
    for start in starts:
        for values in _starting_points(terms, start):
            found = _descend(case, tuple(terms), values, search)
            if best is None or found.cost < best.cost:
                best = found
    assert best is not None
    return best


def _starting_points(terms: Sequence[Term], start: Fit | Constants) -> list[FloatArray]:
    begun = [np.array(start)] if isinstance(start, Constants) else [np.array(start.base)]
    if isinstance(start, Fit):
        begun += list(start.parameters)
    rest = terms[len(begun) - 1 :]
    grids = [product(*(p.start for p in term.parameters)) for term in rest]
    return [
        np.concatenate([*begun, *(np.array(values) for values in combination)])
        for combination in product(*grids)
    ]


@dataclass(frozen=True, slots=True)
class Layout:
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

    def join(self, of_base: Sequence[float], of_terms: Sequence[Sequence[float]]) -> FloatArray:
        """Return the array for the base's values and each term's values."""
        parts = [] if self.case.fixed else [np.array(of_base)]
        return np.concatenate([np.empty(0), *parts, *(np.array(own) for own in of_terms)])

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest constants."""
        low = self.join(LOW.tolist(), [[p.low for p in term.parameters] for term in self.terms])
        high = self.join(HIGH.tolist(), [[p.high for p in term.parameters] for term in self.terms])
        return low, high

    def white(self, x: FloatArray) -> list[FloatArray]:
        """Return the white errors of each drive, then those of the prior and of the terms."""
        base, own = self.split(x)
        rows = np.concatenate([_prior_rows(self.case, base), _term_rows(self.terms, own)])
        return [*_white(self.case, predict(self.case, base, self.terms, own)), rows]

    def judged(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return the parts of ``white``, or of their slopes, as errors in sigma."""
        *white, rows = parts
        return np.concatenate([_judged(self.case, white), rows])


@dataclass(slots=True)
class _Errors:
    """The errors of a layout; a slope is asked for where an error was asked for last."""

    layout: Layout
    steps: FloatArray  # (p,) of the constants, for derivatives
    x: FloatArray | None = None
    parts: list[FloatArray] = field(default_factory=list)

    def at(self, x: FloatArray) -> FloatArray:
        """Return the errors in sigma."""
        return self.layout.judged(self._white(x))

    def slope(self, x: FloatArray) -> FloatArray:
        """Return the derivatives (m, p) of the errors."""
        at, high, columns = self._white(x), self.layout.limits[1], []
        for i, size in enumerate(self.steps.tolist()):
            step = size if x[i] + size < high[i] else -size
            moved = x.copy()
            moved[i] += step
            pairs = zip(self.layout.white(moved), at, strict=True)
            columns.append([(after - before) / step for after, before in pairs])
        return self.layout.judged([np.column_stack(own) for own in zip(*columns, strict=True)])

    def _white(self, x: FloatArray) -> list[FloatArray]:
        if self.x is None or not np.array_equal(x, self.x):
            self.x, self.parts = x.copy(), self.layout.white(x)
        return self.parts


def _descend(case: Case, terms: tuple[Term, ...], start: FloatArray, search: Search) -> Fit:
    layout = Layout(case, terms)
    low, high = layout.limits
    scale = layout.join(
        search.scale, [[_scale(p.start) for p in term.parameters] for term in terms]
    )
    x = start[len(start) - len(low) :]
    tried = _Errors(layout, STEP * scale)
    if len(x) == 0:
        e = tried.at(x)
        return Fit(
            terms=terms,
            base=layout.split(x)[0],
            parameters=(),
            residual=e,
            jacobian=np.empty((len(e), 0)),
            hessian=np.empty((0, 0)),
            cost=float(e @ e) / 2.0,
        )

    margin = INSIDE * (high - low)
    found = least_squares(
        tried.at,
        np.clip(x, low + margin, high - margin),
        tried.slope,
        (low, high),
        x_scale=scale,
        ftol=search.tolerance,
        xtol=search.tolerance,
        max_nfev=search.steps_most,
    )
    base, own = layout.split(found.x)
    jacobian = np.asarray(found.jac, dtype=np.float64)
    m = len(found.fun) - len(_prior_rows(case, base)) - len(_term_rows(terms, own))
    return Fit(
        terms=terms,
        base=base,
        parameters=tuple(own),
        residual=found.fun[:m],
        jacobian=jacobian[:m],
        hessian=jacobian.T @ jacobian,
        cost=float(found.cost),
    )


def _scale(start: Sequence[float]) -> float:
    return max(abs(value) for value in start)


def _prior_rows(case: Case, base: Constants) -> FloatArray:
    if case.prior is None or case.fixed is not None:
        return np.empty(0)
    return (np.array(base) - np.array(case.prior.mean)) / np.array(case.prior.spread)


def _term_rows(terms: Sequence[Term], own: Sequence[FloatArray]) -> FloatArray:
    """Return the distance of parameters from their start, in spreads, for those with a spread."""
    rows = [
        (value - p.start[0]) / p.spread
        for term, values in zip(terms, own, strict=True)
        for p, value in zip(term.parameters, values, strict=True)
        if p.spread is not None
    ]
    return np.array(rows, dtype=np.float64)
