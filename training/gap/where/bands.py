"""At which frequencies the excess lies, and which input it moves with there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from monitor.base.types import FloatArray, IntArray
from training.gap.config import CONFIG
from training.gap.where.bootstrap import Share, draw_counts, share_of
from training.gap.where.drivers import WORDS
from training.gap.where.segments import Segments, input_names, transform
from training.gap.where.surrogates import Sums, p_of_largest, slope
from training.greybox.fit.comparison import Comparison

LIMITS: Final = CONFIG.bands
EDGE: Final = 2.0  # a band is an octave


@dataclass(frozen=True, slots=True)
class Band:
    """One octave of the residual."""

    low_hz: float
    high_hz: float
    share: Share  # of the excess squared error
    p_level: float  # of more power than in healthy recordings; 1 without any
    coherent_with: str  # the input that explains most of the residual's power in the band
    coherence: float  # the share it explains linearly, beyond healthy recordings
    p_coherence: float

    @property
    def significant(self) -> bool:
        """Return whether the band's power or its relation to an input is beyond chance."""
        return self.p_level < LIMITS.false_share or self.coherent

    @property
    def coherent(self) -> bool:
        """Return whether the band moves with an input, beyond chance and worth a sentence."""
        return self.p_coherence < LIMITS.false_share and self.coherence >= LIMITS.coherence_min

    @property
    def sentence(self) -> str:
        """Return the finding in words."""
        text = (
            f"{self.share} of the excess lies between {self.low_hz:.2g} and {self.high_hz:.2g} Hz"
        )
        if self.coherent:
            words = WORDS.get(self.coherent_with, self.coherent_with)
            return f"{text}; it moves with the {words} (coherence {self.coherence:.2f})."
        return f"{text}; it moves with no input there."


@dataclass(frozen=True, slots=True)
class Bands:
    """All octaves, and the spectra for the picture."""

    bands: tuple[Band, ...]  # from low to high
    frequency_hz: FloatArray  # (f,)
    density: FloatArray  # (f,) phi² per Hz
    reference: FloatArray  # (f,) of the healthy recordings, or of white noise
    names: tuple[str, ...]  # (k,)
    coherence: FloatArray  # (b, k) in each band with each input
    p_values: FloatArray  # (b, k)

    @property
    def strongest(self) -> Band | None:
        """Return the band beyond chance with the largest share of the excess."""
        found = [band for band in self.bands if band.significant]
        return max(found, key=lambda band: band.share.value, default=None)


def find_bands(
    recordings: Sequence[Comparison],
    healthy: Sequence[Comparison],
    white_rms: float,
    rng: np.random.Generator,
) -> Bands | None:
    """Return the excess by octave; None if unbroken stretches are too short.

    white_rms : standard deviation of white noise, the reference without healthy recordings
    """
    names = input_names([recordings, healthy] if healthy else [recordings])
    new = transform(recordings, names)
    known = transform(healthy, names) if healthy else None
    if new is None or (healthy and known is None):
        return None
    bins = _octaves(new.frequency_hz)
    coherence, p = _coherence(new, known, bins, rng)
    n = len(new.frequency_hz)
    reference = np.full(n, white_rms**2 / n) if known is None else known.power.mean(axis=0)
    shares = _shares(new, known, reference, bins, rng)
    levels = [_level(new, known, b) for b in bins]
    found = []
    for i, b in enumerate(bins):
        best = int(np.argmin(np.where(p[i] == p[i].min(), -coherence[i], np.inf))) if names else 0
        found.append(
            Band(
                low_hz=float(new.frequency_hz[b[0]]),
                high_hz=float(new.frequency_hz[b[-1]]),
                share=shares[i],
                p_level=min(levels[i] * len(bins), 1.0),
                coherent_with=names[best] if names else "",
                coherence=float(coherence[i, best]) if names else 0.0,
                p_coherence=float(p[i, best]) if names else 1.0,
            )
        )
    step = float(new.frequency_hz[0])
    return Bands(
        bands=tuple(found),
        frequency_hz=new.frequency_hz,
        density=new.power.mean(axis=0) / step,
        reference=reference / step,
        names=names,
        coherence=coherence,
        p_values=p,
    )


def _octaves(frequency_hz: FloatArray) -> list[IntArray]:
    number = np.floor(np.log2(frequency_hz / frequency_hz[-1]) / np.log2(EDGE) - 1e-9)
    return [np.flatnonzero(number == k) for k in np.unique(number) if (number == k).sum() >= 2]


def _coherence(
    new: Segments,
    known: Segments | None,
    bins: Sequence[IntArray],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return (b, k) the share of the residual's power in each band that each input explains."""
    own = _sums(new)
    found = slope(own, None if known is None else _sums(known), rng)
    weight = own.squares.sum(axis=0)  # (f, k)
    power = new.power.sum(axis=0)
    value = np.empty((len(bins), len(new.names)))
    chance = np.empty((len(found.chance), *value.shape))
    for i, b in enumerate(bins):
        value[i] = (np.abs(found.value[b]) ** 2 * weight[b]).sum(axis=0) / power[b].sum()
        moved = np.abs(found.chance[:, b]) ** 2 * weight[b]
        chance[:, i] = moved.sum(axis=1) / power[b].sum()
    if not value.size:
        return value, value
    return np.minimum(value, 1.0), p_of_largest(value, chance)[0]


def _sums(s: Segments) -> Sums:
    products = s.residual[:, :, np.newaxis] * s.inputs.conj()
    return Sums(products, np.abs(s.inputs) ** 2 + 1e-300, s.recording)


def _shares(
    new: Segments,
    known: Segments | None,
    reference: FloatArray,
    bins: Sequence[IntArray],
    rng: np.random.Generator,
) -> list[Share]:
    n = len(new.residual)
    drawn = draw_counts(n, rng) @ new.power / n
    level = np.tile(reference, (len(drawn), 1))
    if known is not None:
        m = len(known.residual)
        level = draw_counts(m, rng) @ known.power / m
    each, excess = drawn - level, new.power.mean(axis=0) - reference
    return [
        share_of(
            float(excess[b].sum()), float(excess.sum()), each[:, b].sum(axis=1), each.sum(axis=1)
        )
        for b in bins
    ]


def _level(new: Segments, known: Segments | None, b: IntArray) -> float:
    """Return the p-value that segments have no more power than healthy ones, on logarithms."""
    if known is None:
        return 1.0
    own, other = (np.log(s.power[:, b].sum(axis=1) + 1e-300) for s in (new, known))
    n, m = (max(LIMITS.segments_independent * len(x), 2.0) for x in (own, other))
    within = float(own.var(ddof=1) / n + other.var(ddof=1) / m)
    between, freedom = _between(((own, new.recording), (other, known.recording)))
    if freedom == 0:
        freedom = round(n + m) - 2
    t = float(own.mean() - other.mean()) / max(float(np.sqrt(within + between)), 1e-300)
    return float(stats.t.sf(t, freedom))


def _between(sides: Sequence[tuple[FloatArray, IntArray]]) -> tuple[float, int]:
    """Return the variance that differences between recordings give the difference of the means.

    And its degrees of freedom, 0 if no side has two recordings.
    """
    squares, freedom, inverse = 0.0, 0, 0.0
    for values, recording in sides:
        means = np.array([values[recording == r].mean() for r in np.unique(recording)])
        squares += float(((means - means.mean()) ** 2).sum())
        freedom += len(means) - 1
        inverse += 1.0 / len(means)
    return (squares / freedom * inverse, freedom) if freedom else (0.0, 0)
