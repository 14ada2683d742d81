"""Drives to explain: what a base with terms predicts for them, and its whitened errors.

Healthy drives differ by message phases on the bus, weather, and operating points that the
correction has not seen. A disagreement counts by its excess over these differences: the errors of a
new drive are judged with its random coefficients integrated out, one set per drive.
Source: Laird and Ware, Random-effects models for longitudinal data, Biometrics 38 (1982).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from monitor.base.types import FloatArray, IntArray
from training.greybox.chain import Constants, simulate
from training.greybox.effects import Effect
from training.greybox.fit.drive import BLOCK_S, ChainDrive, block_numbers, path_of, phi_of
from training.greybox.fit.sensor_faults import FaultHypothesis

Term = Effect | FaultHypothesis
WHITE: Final = (0.9, 0.0)  # nearly differences: slow errors are left to the correction
VALUE_LEAST = 0.02  # of a direction, in sigma squared: a smaller one changes errors by under 1 %


@dataclass(frozen=True, slots=True)
class Shrink:
    """A symmetric root of the precision: I - U diag(share) U', for one drive."""

    directions: NDArray[np.float32]  # (m, q) orthonormal; half the bytes in the loops of a fit
    share: NDArray[np.float32]  # (q,)

    def apply(self, error: FloatArray) -> FloatArray:
        """Return errors, (m,) or (m, k), with the random coefficients integrated out."""
        inner = ((self.directions.T @ error.astype(np.float32)).T * self.share).T
        return np.asarray(error - self.directions @ inner)


def shrink(scaled: FloatArray) -> Shrink:
    """Return the root for whitened columns (m, k) whose coefficients have a spread of 1."""
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    used = values > VALUE_LEAST
    directions = scaled @ vectors[:, used] / np.sqrt(values[used])
    share = 1.0 - 1.0 / np.sqrt(1.0 + values[used])
    return Shrink(np.asfortranarray(directions, np.float32), share.astype(np.float32))


@dataclass(frozen=True, slots=True)
class Case:
    """Drives to explain and everything that a fit needs beside its starting values."""

    drives: tuple[ChainDrive, ...]
    corrections: tuple[FloatArray, ...]  # per drive (n,) in phi: error of the base when healthy
    ar: tuple[float, float] = (0.0, 0.0)  # autoregression of the noise, newest first
    sigma: float = 1.0  # of the whitened noise, in phi
    prior: tuple[Constants, Constants] | None = None  # of the base: mean, standard deviation
    fixed: Constants | None = None  # of the base; a fit then moves the terms' parameters only
    shrinks: tuple[Shrink, ...] = ()  # per drive; empty if the variation of drives is unknown
    scales: tuple[float, ...] = ()  # per drive, of its errors, in sigma; empty if all are 1
    rows: tuple[IntArray, ...] = field(init=False)  # per drive (m,), see ``ChainDrive.kept``

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(np.flatnonzero(d.kept) for d in self.drives))

    @property
    def blocks(self) -> IntArray:
        """The block of each kept sample, (m,), numbered through all drives."""
        return block_numbers(self.rows, round(BLOCK_S / self.drives[0].period_s))


def has_its_signs(term: Term, values: FloatArray) -> bool:
    """Whether all parameters of a term that must be above 0 are above 0."""
    return all(v > 0.0 for p, v in zip(term.parameters, values, strict=True) if p.positive)


def predict(
    case: Case, base: Constants, terms: Sequence[Term], parameters: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return the predicted reading of the sensor, per drive (n,) in phi."""
    return [
        reading(drive, base, terms, parameters, correction)
        for drive, correction in zip(case.drives, case.corrections, strict=True)
    ]


def reading(
    drive: ChainDrive,
    base: Constants,
    terms: Sequence[Term],
    parameters: Sequence[FloatArray],
    correction: FloatArray | float = 0.0,
) -> FloatArray:
    """Return the chain's phi (n,) with effects on the path and sensor faults after the chain.

    correction : (n,) in phi, from the chain to the reading of a healthy sensor
    """
    path = plain = path_of(drive, base)
    for term, values in zip(terms, parameters, strict=True):
        if isinstance(term, Effect):
            path = term.apply(path, values, drive.signals, drive.period_s)
    read = phi_of(drive, base) if path is plain else simulate(path, drive.period_s)
    phi = read + correction
    for term, values in zip(terms, parameters, strict=True):
        if isinstance(term, FaultHypothesis):
            phi = term.read(phi, values, drive.period_s)
    return phi


def errors(case: Case, phi: Sequence[FloatArray]) -> FloatArray:
    """Return prediction minus measurement on the kept samples, whitened, in sigma: (m,)."""
    return judged(case, white(case, phi))


def white(case: Case, phi: Sequence[FloatArray]) -> list[FloatArray]:
    """Return each drive's errors on its kept samples, whitened, before drives' differences."""
    of = zip(phi, case.drives, case.rows, strict=True)
    return [_white(each, d.phi_measured, rows, *case.ar, case.sigma) for each, d, rows in of]


@njit(cache=True)
def _white(predicted, measured, rows, a, b, sigma):  # type: ignore[no-untyped-def]
    out = np.empty(len(rows))
    for i, k in enumerate(rows):
        before = a * (predicted[k - 1] - measured[k - 1]) + b * (predicted[k - 2] - measured[k - 2])
        out[i] = (predicted[k] - measured[k] - before) / sigma
    return out


def judged(case: Case, parts: Sequence[FloatArray]) -> FloatArray:
    """Return white errors of all drives by how drives differ: of (m,) or (m, k) per drive."""
    if case.shrinks:
        parts = [shrink.apply(part) for shrink, part in zip(case.shrinks, parts, strict=True)]
    if case.scales:
        parts = [part / scale for scale, part in zip(case.scales, parts, strict=True)]
    return np.concatenate(parts)


def plain_errors(case: Case, phi: Sequence[FloatArray]) -> FloatArray:
    """Return prediction minus measurement on the kept samples in phi, (m,)."""
    parts = zip(phi, case.drives, case.rows, strict=True)
    return np.concatenate([(each - drive.phi_measured)[rows] for each, drive, rows in parts])
