"""How long after an input the residual answers: cross-correlation of whitened signals.

Residual and input are each filtered by their own autoregressive model, so that a slow signal does
not smear one answer over many lags. Source: Box, Jenkins and Reinsel, Time Series Analysis, 11.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from monitor.base.types import FloatArray, IntArray
from training.gap.where.drivers import WORDS
from training.gap.where.segments import input_names
from training.gap.where.surrogates import Sums, p_of_largest, slope
from training.greybox.fit.comparison import BLOCK_S, Comparison
from training.recordings.preparation import hold

ALPHA: Final = 0.01  # false lags per localisation, all lags and inputs together
LEAST_CORRELATION: Final = 0.1  # 1 % of the whitened squares; less is nobody's gap
ORDER: Final = 8
LONGEST_S: Final = 3.0
# The controller answers the residual at once; only later lags can be an answer to it.
IN_THE_LOOP: Final = frozenset({"lambda_controller", "fuel_mass_mg"})


@dataclass(frozen=True, slots=True)
class Lag:
    """The strongest answer of the residual to one input."""

    input: str
    lag_s: float
    correlation: float  # beyond healthy recordings
    p_value: float
    lags_s: FloatArray  # (l,)
    correlations: FloatArray  # (l,)
    band: FloatArray  # (l,) 99 % of what chance gives, all lags and inputs together

    @property
    def significant(self) -> bool:
        """Return whether the answer is beyond chance and worth a sentence."""
        return self.p_value < ALPHA and abs(self.correlation) >= LEAST_CORRELATION

    @property
    def sentence(self) -> str:
        """Return the finding in words."""
        words = WORDS.get(self.input, self.input)
        side = "richer" if self.correlation > 0 else "leaner"
        return (
            f"{self.lag_s:.2g} s after a step up of the {words} the sensor reads {side} than "
            f"predicted (correlation {self.correlation:+.2f})."
        )


def find_lags(
    recordings: Sequence[Comparison], healthy: Sequence[Comparison], rng: np.random.Generator
) -> tuple[Lag, ...]:
    """Return each input's strongest lag, the clearest first."""
    names = input_names([recordings, healthy] if healthy else [recordings])
    if not names:
        return ()
    period_s = recordings[0].period_s
    lags = np.arange(round(LONGEST_S / period_s) + 1)
    filters = _filters(recordings, names)
    own, residual = _sums(recordings, names, lags, filters)
    known = _sums(healthy, names, lags, filters)[0] if healthy else None
    found = slope(own, known, rng)
    scale = np.sqrt(own.squares.sum(axis=0) / residual)  # per unit of input → correlation
    value, chance = found.value * scale, found.chance * scale
    size, chance_size = np.abs(value), np.abs(chance)
    barred = (lags[:, np.newaxis] == 0) & np.array([n in IN_THE_LOOP for n in names])
    size, chance_size = np.where(barred, 0.0, size), np.where(barred, 0.0, chance_size)
    p, limit = p_of_largest(size, chance_size)
    band = chance_size.mean(axis=0) + limit * chance_size.std(axis=0) + 1e-12
    result = []
    for k, name in enumerate(names):
        clear = p[:, k] < ALPHA
        rank = np.where(clear, size[:, k], 0.0) if clear.any() else size[:, k] / band[:, k]
        top = int(np.argmax(rank))
        result.append(
            Lag(
                name,
                float(lags[top] * period_s),
                float(value[top, k]),
                float(p[top, k]),
                np.asarray(lags * period_s, dtype=np.float64),
                value[:, k],
                band[:, k],
            )
        )
    return tuple(
        sorted(result, key=lambda lag: (not lag.significant, lag.p_value, -abs(lag.correlation)))
    )


def _filters(recordings: Sequence[Comparison], names: Sequence[str]) -> list[FloatArray]:
    """Return the whitening filters of the residual and of each input."""
    series = [[r.residual for r in recordings]]
    series += [[_moving(r, n) for r in recordings] for n in names]
    return [_whitening(each) for each in series]


def _moving(r: Comparison, name: str) -> FloatArray:
    values = hold(r.signals[name])
    return values - values.mean()


def _whitening(series: Sequence[FloatArray]) -> FloatArray:
    """Return [1, -a1, …] of the autoregressive model of the series together (Yule-Walker)."""
    covariance = np.zeros(ORDER + 1)
    for x in series:
        centred = x - x.mean()
        covariance += [float(centred[k:] @ centred[: len(x) - k]) for k in range(ORDER + 1)]
    if covariance[0] <= 0.0:
        return np.array([1.0])
    covariance[0] *= 1.0 + 1e-6
    return np.concatenate([[1.0], -solve_toeplitz(covariance[:-1], covariance[1:])])


def _sums(
    recordings: Sequence[Comparison],
    names: Sequence[str],
    lags: IntArray,
    filters: Sequence[FloatArray],
) -> tuple[Sums, float]:
    """Return sums (b, l, k) of whitened signals over blocks, and the residual's sum of squares."""
    products, squares, number, power = [], [], [], 0.0
    for i, r in enumerate(recordings):
        n = len(r.residual)
        mean = float(r.residual.sum()) / max(int(r.scored.sum()), 1)
        white = lfilter(filters[0], [1.0], np.where(r.scored, r.residual - mean, 0.0))
        whole = lfilter(np.ones(len(filters[0])), [1.0], r.scored.astype(float))
        rows = whole > len(filters[0]) - 0.5  # the filter saw scored samples alone
        white = np.where(rows, white, 0.0)
        power += float(white @ white)
        starts = np.arange(0, n, max(round(BLOCK_S / r.period_s), 1))
        both = []
        for each, name in zip(filters[1:], names, strict=True):
            column = lfilter(each, [1.0], _moving(r, name))
            late = sliding_window_view(np.concatenate([np.zeros(lags[-1]), column]), len(lags))
            late = late[:, ::-1]  # (n, l)
            product = np.add.reduceat(late * white[:, np.newaxis], starts, axis=0)
            both.append((product, np.add.reduceat(late**2 * rows[:, np.newaxis], starts, axis=0)))
        products.append(np.stack([product for product, _ in both], axis=2))
        squares.append(np.stack([square for _, square in both], axis=2))
        number.append(np.full(len(starts), i))
    sums = Sums(np.concatenate(products), np.concatenate(squares) + 1e-300, np.concatenate(number))
    return sums, max(power, 1e-300)
