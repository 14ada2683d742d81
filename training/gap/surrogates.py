"""What chance gives: products of residual and input summed over blocks with random signs.

If residual and input have nothing to do with each other, the sum of their products over a block of
time is as often positive as negative. So the same statistic with a random sign for each block shows
what chance gives, whatever the spectra and however unsteady the drive. Beside healthy recordings
the question is whether the relation has changed; then what both have in common is taken away first.
Source: Wu, Annals of Statistics 14 (1986), wild bootstrap.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from monitor.types import FloatArray

SURROGATES: Final = 999

Products = NDArray[Any]  # (b, …) real or complex


@dataclass(frozen=True, slots=True)
class Slope:
    """Response of the residual to inputs and what chance gives, beyond healthy recordings."""

    value: Products  # (…) residual per unit of input
    chance: Products  # (SURROGATES, …)


def slope(
    products: Products,
    squares: FloatArray,
    healthy: tuple[Products, FloatArray] | None,
    rng: np.random.Generator,
) -> Slope:
    """Return the regression of the residual on each input, each input alone.

    products, squares : (b, …) residual times input and input squared, summed over each block
    """
    if healthy is None:
        total = squares.sum(axis=0)
        return Slope(products.sum(axis=0) / total, _flipped(products, rng) / total)
    own, known = squares.sum(axis=0), healthy[1].sum(axis=0)
    both = (products.sum(axis=0) + healthy[0].sum(axis=0)) / (own + known)
    value = products.sum(axis=0) / own - healthy[0].sum(axis=0) / known
    chance = _flipped(products - both * squares, rng) / own
    chance = chance - _flipped(healthy[0] - both * healthy[1], rng) / known
    return Slope(value, chance)


def _flipped(products: Products, rng: np.random.Generator) -> Products:
    signs = rng.choice([-1.0, 1.0], size=(SURROGATES, len(products)))
    flat = products.reshape(len(products), -1)
    return np.asarray((signs @ flat).reshape(SURROGATES, *products.shape[1:]))


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
