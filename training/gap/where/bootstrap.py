"""Shares of the excess squared error with bounds from a block bootstrap.

Blocks of time are drawn with replacement, so that neighbouring samples do not count as independent
ones. Source: Künsch, Annals of Statistics 17 (1989).
"""

from dataclasses import dataclass

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.config import CONFIG
from training.pages.numbers import percent

DRAWS = 500
SIGNS = 1999


@dataclass(frozen=True, slots=True)
class Share:
    """A share of the excess squared error, 0 to 1, with its 90 % bounds."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{percent(self.value)} ({percent(self.low)} to {percent(self.high)})"


@dataclass(frozen=True, slots=True)
class Excess:
    """Mean squared error beyond a reference, per drawn set of blocks for the bounds."""

    mean_square: float  # of the recordings, phi²
    reference: float  # mean square of the healthy recordings, or the noise floor squared
    low: float  # 90 % bounds of the difference
    high: float
    relative: bool  # the reference comes from healthy recordings
    counts: IntArray  # (DRAWS, n_blocks) how often a block was drawn
    whole: float  # what shares are of
    wholes: FloatArray  # (DRAWS,) the same for each draw
    samples: FloatArray  # (n_blocks,)

    @property
    def value(self) -> float:
        """Return the excess mean square; may be negative."""
        return self.mean_square - self.reference

    def share(self, explained: FloatArray) -> Share:
        """Return the share of ``explained`` (n_blocks,), a sum of squares in each block.

        The explained part belongs to the excess: the whole is never less than it.
        """
        part = float(explained.sum() / self.samples.sum())
        parts = (self.counts @ explained) / (self.counts @ self.samples)
        return share_of(part, self.whole, parts, self.wholes)


def share_of(part: float, whole: float, parts: FloatArray, wholes: FloatArray) -> Share:
    """Return part over whole with the bounds that the draws (DRAWS,) of both give."""
    ratios = _ratio(parts, wholes)
    tail = 50.0 * (1.0 - CONFIG.excess.confidence)
    low, high = np.percentile(ratios, [tail, 100.0 - tail])
    value = float(_ratio(np.array([part]), np.array([whole]))[0])
    return Share(value, float(min(low, value)), float(max(high, value)))


def _ratio(part: FloatArray, whole: FloatArray) -> FloatArray:
    top = np.maximum(part, 0.0)
    return np.asarray(top / np.maximum(np.maximum(whole, top), np.finfo(float).tiny))


def draw_counts(n_blocks: int, rng: np.random.Generator) -> IntArray:
    """Return how often each block is drawn, (DRAWS, n_blocks)."""
    return np.asarray(rng.multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=DRAWS))


def excess(
    squares: FloatArray,
    samples: FloatArray,
    reference: tuple[FloatArray, FloatArray] | float,
    least: float,
    rng: np.random.Generator,
) -> Excess:
    """Return the excess of the squares in each block (n_blocks,) over a reference.

    reference : sums of squares and samples of each healthy block, or a mean square
    least : mean square of white noise. Where nothing is clearly above the reference, shares are of
        all that is above the least, so that they are rather too small than too large.
    """
    counts = draw_counts(len(squares), rng)
    drawn = (counts @ squares) / (counts @ samples)
    if isinstance(reference, float):
        value, references = reference, np.full(DRAWS, reference)
    else:
        own = draw_counts(len(reference[0]), rng)
        references = (own @ reference[0]) / (own @ reference[1])
        value = float(reference[0].sum() / reference[1].sum())
    tail = 50.0 * (1.0 - CONFIG.excess.confidence)
    low, high = (float(v) for v in np.percentile(drawn - references, [tail, 100.0 - tail]))
    mean_square = float(squares.sum() / samples.sum())
    relative = not isinstance(reference, float)
    whole, wholes = mean_square - value, drawn - references
    if low <= 0.0:
        whole, wholes = mean_square - least, drawn - least
    return Excess(
        mean_square=mean_square,
        reference=value,
        low=low,
        high=high,
        relative=relative,
        counts=counts,
        whole=whole,
        wholes=np.asarray(wholes),
        samples=samples,
    )


def p_of_gains(gains: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the p-values (c,) that gains of held-out blocks (c, n_blocks) are not above 0.

    Corrected for all candidates together: their largest t is held against that of blocks with
    random signs, the same for all candidates, because candidates that move together are not so
    many. Each counts with the better of two t: of signed square roots, in which a few large blocks
    weigh less, and of the gains, for what gains much in some blocks and loses a little in many.
    Source: Westfall and Young, Resampling-Based Multiple Testing, 1993.
    """
    roots = np.sign(gains) * np.sqrt(np.abs(gains))
    both = np.concatenate([roots, gains])
    signs = rng.choice([-1.0, 1.0], size=(SIGNS, gains.shape[1]))
    squares = (both**2).sum(axis=1)
    chance = np.sort(_t(signs @ both.T, squares, gains.shape[1]).max(axis=1))
    t = _t(both.sum(axis=1), squares, gains.shape[1])
    largest = np.maximum(t[: len(gains)], t[len(gains) :])
    above = SIGNS - np.searchsorted(chance, largest * (1.0 - 1e-12))
    return np.asarray((1.0 + above) / (1.0 + SIGNS))


def _t(sums: FloatArray, squares: FloatArray, n: int) -> FloatArray:
    """Return t of the mean from sums (…, c) and sums of squares (c,) of n values."""
    variance = np.maximum(squares - sums**2 / n, 1e-300) / (n - 1.0)
    return np.asarray(sums / np.sqrt(n * variance))
