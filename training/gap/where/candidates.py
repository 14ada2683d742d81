"""Candidates for the cause of an excess: a smooth function of one driver at one point.

The function enters at one of four points:

    before the transport   it travels the dead time and the lag to the sensor
    at the sensor          it acts where and when the sensor reads
    timing                 it times the slope of phi: an edge comes too early or too late
    sensitivity            it times phi - 1: the sensor reads too much or too little
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.where.bootstrap import Excess
from training.gap.where.drivers import AT_SENSOR, Driver, find_drivers, rate
from training.gap.where.splines import (
    Basis,
    Normal,
    common_coefficients,
    healthy_coefficients,
    held_out,
    normal,
    offset,
    solve,
)
from training.gap.where.transport import Transport
from training.greybox.fit.comparison import Comparison, Stack, gather
from training.recordings.rows import hold

Point = Literal["before the transport", "at the sensor", "timing", "sensitivity"]
POINTS: Final[tuple[Point, ...]] = get_args(Point)
EVERYWHERE: Final = "everywhere"


@dataclass(frozen=True, slots=True)
class Side:
    """Recordings with blocks, drivers and transport, which every candidate needs."""

    recordings: Sequence[Comparison]
    blocks: Stack
    drivers: dict[str, Driver]
    transport: Transport | None

    @classmethod
    def of(
        cls, recordings: Sequence[Comparison], blocks: Stack, transport: Transport | None
    ) -> "Side":
        """Return the side with all its drivers."""
        drivers = {d.name: d for d in find_drivers(recordings)}
        return cls(recordings, blocks, drivers, transport)

    def functions(self, name: str, basis: Basis | None) -> list[FloatArray]:
        """Return the functions (n, k) of a driver in each recording; constants without a basis."""
        if basis is None:
            return [np.ones((len(r.residual), 1)) for r in self.recordings]
        return [basis(values) for values in self.drivers[name].values]

    def design(self, functions: Sequence[FloatArray], point: Point) -> FloatArray:
        """Return a driver's functions (m, k) as they act from ``point``, at the scored samples."""
        made = []
        for i, (r, values) in enumerate(zip(self.recordings, functions, strict=True)):
            phi = hold(r.phi_predicted)
            if point == "before the transport" and self.transport is not None:
                made.append(self.transport.move(values, i, r.period_s))
            elif point == "timing":
                made.append(_beside_constant(values, rate(phi, r.period_s)))
            elif point == "sensitivity":
                made.append(_beside_constant(values, phi - 1.0))
            else:
                made.append(values)
        return gather(made, self.blocks)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A driver and point, and the squared error that they take away."""

    driver: Driver | None
    point: Point
    basis: Basis | None
    median: float  # of the driver
    new: Normal
    healthy: Normal | None
    gains: FloatArray  # (n_blocks,) squared error taken away beyond what healthy blocks know
    tested: FloatArray  # (n_blocks,) the same beyond what healthy and new blocks have in common

    @property
    def name(self) -> str:
        """Return the driver's name."""
        return EVERYWHERE if self.driver is None else self.driver.name


def points(name: str, side: Side) -> tuple[Point, ...]:
    """Return the points at which a driver may enter."""
    if name == EVERYWHERE:
        return ("at the sensor", "timing", "sensitivity")
    if name == "phi_predicted":
        return ("at the sensor",)  # times phi - 1 it is the same again
    if name in AT_SENSOR or side.transport is None:
        return ("at the sensor", "timing", "sensitivity")
    return POINTS


def evaluate(new: Side, healthy: Side | None, name: str) -> list[Candidate]:
    """Return the candidates of a driver, one for each point, fitted and scored on other blocks."""
    driver = new.drivers.get(name)
    values = np.zeros(1) if driver is None else gather(driver.values, new.blocks)
    basis = None if driver is None else Basis.of(values)
    functions = new.functions(name, basis)
    of_healthy = None if healthy is None else (healthy, healthy.functions(name, basis))
    median = float(np.median(values))
    found = []
    for point in points(name, new):
        own = normal(new.design(functions, point), new.blocks)
        known = None
        if of_healthy is not None:
            side, theirs = of_healthy
            known = normal(side.design(theirs, point), side.blocks)
        is_offset = driver is None and point == "at the sensor"
        gains, tested = _gains(own, known, new.blocks.fold, None if is_offset else point)
        found.append(
            Candidate(
                driver=driver,
                point=point,
                basis=basis,
                median=median,
                new=own,
                healthy=known,
                gains=gains,
                tested=tested,
            )
        )
    return found


def _gains(
    own: Normal, known: Normal | None, fold: IntArray, point: Point | None
) -> tuple[FloatArray, FloatArray]:
    """Return ``gains`` and ``tested`` of a candidate; beside an offset unless ``point`` is None."""
    reference, common = np.zeros_like(own.right), np.zeros_like(own.right)
    if known is not None:
        reference = np.tile(healthy_coefficients(known), (len(fold), 1))
        common = common_coefficients(own, known, fold)
    if point is not None:  # an offset explains nothing of a regime
        level = _constant(own.right.shape[1], point)
        reference, common = (offset(own, c, level, fold) for c in (reference, common))
    after = own.error(held_out(own, fold))
    return own.error(reference) - after, own.error(common) - after


def _beside_constant(values: FloatArray, factor: FloatArray) -> FloatArray:
    """Return functions (n, k) times ``factor`` (n,), and a constant as the last one."""
    return np.column_stack([values * factor[:, np.newaxis], np.ones(len(values))])


def _constant(k: int, point: Point) -> FloatArray:
    """Return the coefficients (k,) of the candidate's functions that make a constant of 1."""
    return np.eye(k)[-1] if point in ("timing", "sensitivity") else np.ones(k)


@dataclass(frozen=True, slots=True)
class Curve:
    """How the excess depends on the driver, with its 90 % band from the block bootstrap."""

    x: FloatArray  # (p,) in the driver's unit
    y: FloatArray  # (p,) phi; s for timing, a ratio for sensitivity
    low: FloatArray
    high: FloatArray
    typical: float  # value of y at the driver's median


def curve_of(c: Candidate, excess: Excess) -> Curve:
    """Return the dependence beyond that of healthy recordings, over the driver's range."""
    assert c.basis is not None
    x = np.linspace(*c.basis.ends, 60)
    functions = c.basis(x)
    k = functions.shape[1]
    known = 0.0 if c.healthy is None else healthy_coefficients(c.healthy)
    drawn = solve(
        np.einsum("db,bij->dij", excess.counts.astype(float), c.new.gram),
        excess.counts @ c.new.right,
    )
    best = solve(c.new.gram.sum(0), c.new.right.sum(0)) - known
    curves = (drawn - known)[:, :k] @ functions.T
    low, high = np.percentile(curves, [5, 95], axis=0)
    y = functions @ best[:k]
    return Curve(x=x, y=y, low=low, high=high, typical=float(np.interp(c.median, x, y)))
