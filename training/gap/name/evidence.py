"""The log evidence of a hypothesis: how likely the errors are that it leaves.

It leaves noise, and a random sum of all functions of the ceiling, which is integrated out: healthy
drives differ from what other healthy drives say, and a vehicle's effect has another form than the
library's. The energy of that sum is a constant and a share of what the hypothesis explains. So a
strong effect is held to its form less strictly than noise would allow, and the freedom of a cause
that is nothing in particular is paid for.
Source: MacKay, Bayesian interpolation, Neural Computation 4 (1992), equations 2.12 and 2.13.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.effects.form.effect import Parameter
from training.healthy import scoring

SIZE_LEAST: Final = 1e-6  # of a column, in sigma; a smaller one says nothing
VALUE_LEAST: Final = 1e-4  # of a direction, of columns of unit size
DECADES: Final = (2.0, 6.0)  # of the energy of what no hypothesis has
STEPS_PER_DECADE: Final = 4
WIDEST: Final = 10.0  # times a constant's start: as far as it is looked for
SPREAD_WIDTH: Final = 2.5  # the range of a normal constant, in spreads


@dataclass(frozen=True, slots=True)
class Directions:
    """Directions of everything that could be explained, and the part of each in a random sum."""

    basis: FloatArray  # (m, q) orthonormal
    share: FloatArray  # (q,) of the energy, about 1 in sum

    @classmethod
    def of(cls, roof: scoring.Ceiling) -> "Directions":
        """Return the directions of columns that have a random weight each, of equal energy."""
        size = np.sqrt((roof.columns**2).sum(axis=0))
        columns = roof.columns[:, size > SIZE_LEAST] / size[size > SIZE_LEAST]
        values, vectors = np.linalg.eigh(columns.T @ columns)
        used = values > VALUE_LEAST
        basis = columns @ vectors[:, used] / np.sqrt(values[used])
        return cls(basis, values[used] / columns.shape[1])

    def seen(self, errors: FloatArray) -> "SeenErrors":
        """Return errors (m,) in sigma by their part in each direction, outliers bounded."""
        bounded = np.clip(errors, -scoring.LARGEST, scoring.LARGEST)
        return SeenErrors(self.basis.T @ bounded, float(bounded @ bounded))

    def log_evidence(self, seen: "SeenErrors", energy: FloatArray) -> FloatArray:
        """Return the log evidence of errors whose random sum has the energies (k,) given, (k,)."""
        variance = 1.0 + np.multiply.outer(energy, self.share)
        squares = seen.parts**2
        inside = (squares / variance - squares + np.log(variance)).sum(axis=-1)
        return np.asarray(-0.5 * (inside + seen.squares))

    def of_any(self, seen: "SeenErrors", least: float) -> float:
        """Return the log evidence of errors of which nothing is known but that they have a cause.

        least : energy that healthy drives show
        """
        low, high = DECADES
        steps = round((high - low) * STEPS_PER_DECADE) + 1
        energy = np.maximum(np.logspace(low, high, steps), least)
        logs = self.log_evidence(seen, energy)
        return float(np.logaddexp.reduce(logs) - np.log(steps))


@dataclass(frozen=True, slots=True)
class SeenErrors:
    """Errors in directions."""

    parts: FloatArray  # (..., q)
    squares: float | FloatArray  # (...,) their sum of squares


def freedom(parameters: Sequence[Parameter], standard_errors: FloatArray) -> float:
    """Return the log of how much narrower the data hold the constants than the library does."""
    cost = 0.0
    for p, error in zip(parameters, standard_errors.tolist(), strict=True):
        width = p.high - p.low if p.spread is None else SPREAD_WIDTH * p.spread
        largest = max(abs(value) for value in p.start)
        width = min(width, WIDEST * largest) if largest > 0.0 else width
        cost += float(np.log(max(width / max(SPREAD_WIDTH * error, 1e-12), 1.0)))
    return cost
