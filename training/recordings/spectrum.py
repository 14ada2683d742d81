"""Power spectra of unbroken stretches, narrow lines in them, and the signals that share a line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage, signal, stats

from monitor.base.types import FloatArray

LENGTHS = (512, 256, 128, 64)  # samples of a segment, the first that gives enough averages
ENOUGH = 16  # averages wanted: 1 dB of standard deviation
OVERLAP_LOSS = 1.056  # averages of half overlapping Hann segments count so much less: Welch 1967
BACKGROUND_BINS = 41  # of the running median, several times as wide as a line
LOWEST_BINS = 4  # the window smears trend and mean into these
NARROW = 0.05  # of the Nyquist frequency; a wider peak is part of the background
LEAST_DB = 3.0  # above the background; less is of no use to anybody
ALPHA = 0.001  # false lines per spectrum
TREND: Any = "linear"  # that a segment loses; the stubs of scipy do not know it


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power spectral densities of several signals from the same samples."""

    frequency_hz: FloatArray  # (f,)
    density: FloatArray  # (f, k), unit² per Hz
    coherence: FloatArray  # (f, k) magnitude squared, with the last signal
    averages: float  # independent segments


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A narrow peak over the smooth background."""

    low_hz: float
    high_hz: float
    peak_hz: float
    above_db: float  # peak over background
    p_value: float  # of the peak, corrected for the number of bins
    power: float  # above the background, unit²


def welch(stretches: Sequence[FloatArray], period_s: float) -> Spectrum | None:
    """Return the averaged spectrum of ``stretches`` (n_i, k); None if all are too short.

    Segments overlap by half, carry a Hann window and lose their linear trend.
    Source: Welch, IEEE Trans. Audio Electroacoustics 15 (1967).
    """
    for length in LENGTHS:
        long = [s for s in stretches if len(s) >= length]
        counts = [(len(s) - length // 2) // (length // 2) for s in long]
        if sum(counts) >= ENOUGH:
            break
    else:
        return None
    rows, total = stretches[0].shape[1], sum(counts)
    density = np.zeros((rows, length // 2 + 1))
    cross = np.zeros((rows, length // 2 + 1), dtype=np.complex128)
    for values, count in zip(long, counts, strict=True):
        own = np.ascontiguousarray(values.T)
        rate, share = 1.0 / period_s, count / total
        density += share * signal.welch(own, rate, nperseg=length, detrend=TREND)[1]
        cross += share * signal.csd(own, own[-1:], rate, nperseg=length, detrend=TREND)[1]
    scale = density * density[-1]
    coherence = np.abs(cross) ** 2 / np.where(scale > 0, scale, np.inf)
    frequency = np.asarray(np.fft.rfftfreq(length, period_s), dtype=np.float64)
    return Spectrum(frequency, density.T, coherence.T, total / OVERLAP_LOSS)


def background(density: FloatArray) -> FloatArray:
    """Return the smooth background of ``density`` (f,): a running median of its logarithm."""
    floor = np.maximum(density, np.finfo(float).tiny)
    size = min(BACKGROUND_BINS, len(density) // 3 | 1)
    return np.asarray(np.exp(ndimage.median_filter(np.log(floor), size, mode="mirror")))


def find_lines(
    frequency_hz: FloatArray, density: FloatArray, averages: float
) -> list[SpectralLine]:
    """Return the narrow lines in one spectrum (f,), the strongest first.

    A bin belongs to a line if its ratio to the background is beyond what a chi-square with two
    degrees of freedom per average allows in any of the bins (Bonferroni), where the limit is
    widened by how much more the whole spectrum scatters than it should.
    """
    smooth = background(density)
    ratio = np.log(np.maximum(density, np.finfo(float).tiny) / smooth)
    first, last = LOWEST_BINS, len(ratio) - 3  # the last bins are folded and half as high
    limit, widened = _limit(ratio[first : last + 1], averages)
    step = float(frequency_hz[1])
    lines: list[SpectralLine] = []
    for peak in first + np.argsort(-ratio[first : last + 1]):
        low, high = _half(ratio, int(peak))
        if ratio[peak] <= limit:
            break
        taken = any(a.low_hz <= frequency_hz[peak] <= a.high_hz for a in lines)
        narrow = (high - low) * step < NARROW * frequency_hz[-1]
        if taken or not narrow or low <= first or high >= last:  # a line has two sides
            continue
        rows = slice(low - 1, high + 2)
        p = (last - first + 1) * stats.chi2.sf(
            2.0 * averages * np.exp(ratio[peak] / widened), 2.0 * averages
        )
        lines.append(
            SpectralLine(
                low_hz=float(frequency_hz[low - 1]),
                high_hz=float(frequency_hz[high + 1]),
                peak_hz=float(frequency_hz[peak]),
                above_db=float(ratio[peak]) * 10.0 / float(np.log(10.0)),
                p_value=min(float(p), 1.0),
                power=float((density[rows] - smooth[rows]).sum()) * step,
            )
        )
    return lines


def _limit(ratio: FloatArray, averages: float) -> tuple[float, float]:
    """Return the least log ratio of a line, and the factor of scatter beyond chance in it."""
    degrees = 2.0 * averages
    scatter = 1.4826 * float(np.median(np.abs(ratio)))
    widened = max(1.0, scatter / float(np.sqrt(2.0 / degrees)))
    by_chance = widened * float(np.log(stats.chi2.isf(ALPHA / len(ratio), degrees) / degrees))
    return max(by_chance, LEAST_DB / 10.0 * float(np.log(10.0))), widened


def coherence_limit(averages: float, alpha: float = 0.05) -> float:
    """Return the coherence that unrelated signals exceed with probability ``alpha``.

    Source: Carter, IEEE Trans. Audio Electroacoustics 21 (1973).
    """
    return float(1.0 - alpha ** (1.0 / max(averages - 1.0, 1.0)))


def _half(ratio: FloatArray, peak: int) -> tuple[int, int]:
    """Return the outermost bins round ``peak`` above half its height in decibels."""
    below = ratio < 0.5 * ratio[peak]
    left, right = np.flatnonzero(below[:peak]), np.flatnonzero(below[peak:])
    low = int(left[-1]) + 1 if len(left) else 0
    high = peak + int(right[0]) - 1 if len(right) else len(ratio) - 1
    return low, high
