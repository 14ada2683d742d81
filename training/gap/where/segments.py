"""Spectra of the residual and the inputs on short segments.

A segment is as short as will hold a manoeuvre, because the statistics over segments need many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.signal import detrend
from scipy.signal.windows import hann

from monitor.base.types import FloatArray, IntArray
from training.gap.config import CONFIG
from training.gap.where.drivers import NO_DRIVERS
from training.greybox.fit.comparison import Comparison
from training.recordings.rows import hold

LIMITS: Final = CONFIG.bands


@dataclass(frozen=True, slots=True)
class Segments:
    """Fourier transforms of half overlapping segments, Hann window, linear trend removed."""

    frequency_hz: FloatArray  # (f,)
    residual: "np.ndarray[tuple[int, int], np.dtype[np.complex128]]"  # (s, f)
    inputs: "np.ndarray[tuple[int, int, int], np.dtype[np.complex128]]"  # (s, f, k)
    names: tuple[str, ...]
    recording: IntArray  # (s,)

    @property
    def power(self) -> FloatArray:
        """Return the residual's power in each bin of each segment, (s, f), phi²."""
        return np.asarray(np.abs(self.residual) ** 2)


def input_names(sides: Sequence[Sequence[Comparison]]) -> tuple[str, ...]:
    """Return the signals that every recording has and that move in the first side."""
    every = [r for side in sides for r in side]
    first = sides[0]
    return tuple(
        name
        for name in first[0].signals
        if name not in NO_DRIVERS
        and all(name in r.signals for r in every)
        and any(float(np.std(hold(r.signals[name]))) > 0.0 for r in first)
    )


def transform(recordings: Sequence[Comparison], names: Sequence[str]) -> Segments | None:
    """Return the segments in which most samples are scored; None if they are too few.

    All recordings have one period. A bin of the one-sided power sums to the variance.
    """
    period_s = recordings[0].period_s
    length = 2 ** max(round(np.log2(LIMITS.segment_s / period_s)), 4)
    window = hann(length, sym=False)
    scale = np.sqrt(2.0 / (float((window**2).sum()) * length))
    residual, inputs, number = [], [], []
    for i, r in enumerate(recordings):
        scored = r.scored.astype(float)
        mean = float(r.residual.sum()) / max(float(scored.sum()), 1.0)
        columns = [(r.residual - mean) * scored, *(hold(r.signals[n]) for n in names)]
        for start in range(0, len(scored) - length + 1, length // 2):
            rows = slice(start, start + length)
            if scored[rows].mean() < LIMITS.segment_scored_min:
                continue
            cut = detrend(np.column_stack([c[rows] for c in columns]), axis=0)
            spectrum = scale * np.fft.rfft(cut * window[:, np.newaxis], axis=0)
            residual.append(spectrum[1:, 0])
            inputs.append(spectrum[1:, 1:])
            number.append(i)
    if len(residual) < LIMITS.segments_min:
        return None
    frequency = np.asarray(np.fft.rfftfreq(length, period_s)[1:], dtype=np.float64)
    return Segments(
        frequency_hz=frequency,
        residual=np.array(residual),
        inputs=np.array(inputs),
        names=tuple(names),
        recording=np.array(number),
    )
