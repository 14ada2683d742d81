"""Chance by surrogates: products of residual and input, summed over blocks with random signs.

If residual and input have nothing to do with each other, the sum of their products over a block of
time is as often positive as negative. So the same statistic with a random sign for each block shows
what chance gives, whatever the spectra and however unsteady the drive. Beside healthy recordings
the question is whether the relation has changed; then what both have in common is taken away first,
and how much it differs from one recording to the next of the same kind counts as chance, too.
Source: Wu, Annals of Statistics 14 (1986), wild bootstrap.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import FloatArray, IntArray

SURROGATES: Final = 999

Products = NDArray[Any]  # (b, …) real or complex


@dataclass(frozen=True, slots=True)
class Slope:
    """Response of the residual to inputs beyond healthy recordings, and its surrogates."""

    value: Products  # (…) residual per unit of input
    chance: Products  # (SURROGATES, …)


@dataclass(frozen=True, slots=True)
class Sums:
    """Sums over blocks of time."""

    products: Products  # (b, …) residual times input
    squares: FloatArray  # (b, …) input squared, above 0 in total
    recording: IntArray  # (b,) each block's recording


def slope(new: Sums, healthy: Sums | None, rng: np.random.Generator) -> Slope:
    """Return the regression of the residual on the inputs, one at a time."""
    own = new.squares.sum(axis=0)
    if healthy is None:
        return Slope(new.products.sum(axis=0) / own, _flipped(new.products, rng) / own)
    known = healthy.squares.sum(axis=0)
    both = (new.products.sum(axis=0) + healthy.products.sum(axis=0)) / (own + known)
    value = new.products.sum(axis=0) / own - healthy.products.sum(axis=0) / known
    chance = np.zeros((SURROGATES, *own.shape), dtype=new.products.dtype)
    for side, total, sign in ((new, own, 1.0), (healthy, known, -1.0)):
        chance += sign * _flipped(side.products - both * side.squares, rng) / total
        chance += sign * _between(side, rng) / total
    return Slope(value, chance)


def _flipped(products: Products, rng: np.random.Generator) -> Products:
    signs = rng.choice([-1.0, 1.0], size=(SURROGATES, len(products)))
    flat = products.reshape(len(products), -1)
    return np.asarray((signs @ flat).reshape(SURROGATES, *products.shape[1:]))


def _between(side: Sums, rng: np.random.Generator) -> Products:
    """Return random sums of the recordings' distances from their side; 0 for one recording."""
    own = side.products.sum(axis=0) / side.squares.sum(axis=0)
    rest = side.products - own * side.squares
    each = np.array([rest[side.recording == r].sum(axis=0) for r in np.unique(side.recording)])
    n = len(each)
    if n < 2:
        return np.zeros((SURROGATES, *own.shape))
    weights = rng.standard_normal((SURROGATES, n)) * np.sqrt(n / (n - 1.0))
    return np.asarray((weights @ each.reshape(n, -1)).reshape(SURROGATES, *own.shape))


def p_of_largest(value: FloatArray, chance: FloatArray) -> tuple[FloatArray, float]:
    """Return p-values (…) corrected for all places, and the value that chance stays below.

    value : (…) statistic at each place, chance : (SURROGATES, …). Places are made comparable by
    mean and standard deviation of chance, then held against chance's largest place.
    """
    mean, spread = chance.mean(axis=0), chance.std(axis=0) + 1e-300
    largest = ((chance - mean) / spread).reshape(len(chance), -1).max(axis=1)
    above = (largest[:, np.newaxis] >= ((value - mean) / spread).ravel()).sum(axis=0)
    p = (1.0 + above) / (1.0 + len(chance))
    return p.reshape(value.shape), float(np.quantile(largest, 0.99))
