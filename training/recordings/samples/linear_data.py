"""The samples of linear baselines: filtered, detrended and z-scored.

Trend removal and the zero-phase filter look ahead. They serve the linear baselines of the study
and never the model that ships.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy import signal

from monitor.base.counts import plain
from monitor.base.errors import RecordingError
from monitor.base.runs import runs
from monitor.base.types import FloatArray
from monitor.model.step import to_model_units
from training.recordings.recording import Recording
from training.recordings.samples.preparation import columns_of, output_transform

FILTER_ORDER = 2  # of the Butterworth prototype; a band-stop has twice as many poles
FILTER_MARGIN_HZ = 0.1  # by which the stop band is wider than the line on both sides
NEAR_NYQUIST = 0.9  # a band beyond this share of the Nyquist frequency takes a low-pass
BRIDGE = 3  # a hole of at most so many samples (an outlier, a lost frame) is bridged linearly
SHORTEST = 60  # samples of a stretch that is worth fitting to, and enough for the filter's ends


@dataclass(frozen=True, slots=True)
class Filter:
    """A zero-phase Butterworth filter against a narrow band; it runs forward and backward."""

    kind: str  # bandstop or lowpass
    order: int
    edges_hz: tuple[float, ...]  # where it takes 6 dB, 3 dB in each direction
    period_s: float
    attenuation_db: float  # the least one in the band

    @classmethod
    def against(cls, band_hz: Sequence[float], period_s: float) -> "Filter":
        """Return the filter for a band [f_low, f_high] in Hz.

        Raises ValueError if the band is not within (0, Nyquist frequency).
        """
        low, high = (float(f) for f in band_hz)
        nyquist = 0.5 / period_s
        if not 0.0 < low <= high < nyquist:
            raise ValueError(f"band {low:g} to {high:g} Hz: wanted within 0 to {nyquist:g} Hz")
        margin = min(FILTER_MARGIN_HZ, 0.5 * low)
        top = high + margin
        kind = "lowpass" if top > NEAR_NYQUIST * nyquist else "bandstop"
        edges = (low - margin,) if kind == "lowpass" else (low - margin, top)
        sections = _sections(kind, FILTER_ORDER, edges, period_s)
        _, response = signal.freqz_sos(sections, np.linspace(low, high, 21), fs=1.0 / period_s)
        gain = max(float(np.abs(response).max()) ** 2, 1e-15)
        return cls(kind, FILTER_ORDER, edges, period_s, -20.0 * float(np.log10(gain)))

    def apply(self, values: FloatArray) -> FloatArray:
        """Return filtered values (n, k), without delay."""
        sections = _sections(self.kind, self.order, self.edges_hz, self.period_s)
        return np.asarray(signal.sosfiltfilt(sections, values, axis=0))


@dataclass(frozen=True, slots=True)
class Trend:
    """A line through one recording: zero at its middle, rising by ``slope`` per second."""

    middle_s: float
    slope: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class LinearData:
    """Linear trend of each recording, then common mean and standard deviation.

    A trend belongs to the recording with its sha256. Other recordings have none, so that a held-out
    recording does not influence its own scaling. The last name is the output.
    """

    names: tuple[str, ...]
    transform: str  # of the output, which comes in model units: "phi" is 1 / lambda
    mean: tuple[float, ...]
    std: tuple[float, ...]
    trends: Mapping[str, Trend] = field(default_factory=dict)
    filter: Filter | None = None  # of the samples before

    def apply(self, values: FloatArray, t_s: FloatArray, sha256: str = "") -> FloatArray:
        """Return z-scored values (n, k) of ``values`` (n, k) at ``t_s`` (n,) of a recording."""
        trend = self.trends.get(sha256, Trend(0.0, (0.0,) * len(self.names)))
        line = np.outer(t_s - trend.middle_s, trend.slope)
        return np.asarray((values - line - self.mean) / self.std)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, which keeps every digit."""
        return asdict(self) | {"trends": {k: asdict(t) for k, t in self.trends.items()}}


@dataclass(frozen=True, slots=True)
class LinearStretch:
    """Unbroken samples of one recording, the output last and in model units."""

    recording: int
    first: int  # row of the recording
    t_s: FloatArray  # (n,)
    values: FloatArray  # (n, k + 1)


def linear_stretches(
    recordings: Sequence[Recording],
    inputs: Sequence[str],
    output: str,
    band: Sequence[float] | None = None,
    *,
    reference: LinearData | None = None,
) -> tuple[list[LinearStretch], LinearData]:
    """Return the filtered unbroken stretches before trend and scaling, and the scaling.

    recordings : of one sample period
    band : narrow noise band in Hz that a zero-phase filter takes out of inputs and output
    reference : scaling and filter of other recordings, for held-out ones; ``band`` is then ignored
    Raises RecordingError for a missing signal, a constant one, or no stretch of 60 samples.
    """
    names = (*inputs, output)
    parts = _unbroken(recordings, names)
    own = reference.filter if reference else None
    if band is not None and reference is None:
        own = Filter.against(band, recordings[0].period_ns / 1e9)
    if own is not None:
        parts = [replace(p, values=own.apply(p.values)) for p in parts]
    return parts, reference or _measure(recordings, parts, names, own)


def cleaned(recording: Recording, names: Sequence[str], transform: str) -> FloatArray:
    """Return the signals (n, k); outliers are NaN, holes of up to 3 samples are bridged.

    transform : of the last column
    """
    values = columns_of(recording, names, {})
    values[:, -1] = to_model_units(transform, values[:, -1])
    for column in values.T:
        _bridge(column)
    return values


def _bridge(column: FloatArray) -> None:
    missing = np.isnan(column)
    known = np.flatnonzero(~missing)
    for first, stop in runs(missing):
        if stop - first <= BRIDGE and first > 0 and stop < len(column):
            column[first:stop] = np.interp(np.arange(first, stop), known, column[known])


def _unbroken(recordings: Sequence[Recording], names: Sequence[str]) -> list[LinearStretch]:
    transform = output_transform(names[-1])
    parts = []
    for index, recording in enumerate(recordings):
        values = cleaned(recording, names, transform)
        for first, stop in runs(np.asarray(np.isfinite(values).all(axis=1))):
            if stop - first >= SHORTEST:
                rows = slice(first, stop)
                parts.append(LinearStretch(index, first, recording.t_s[rows], values[rows]))
    if not parts:
        files = ", ".join(str(r.path) for r in recordings) or "no recordings"
        raise RecordingError(
            f"{files}: no stretch of {SHORTEST} samples with {', '.join(names)} all valid"
        )
    return parts


def _measure(
    recordings: Sequence[Recording],
    parts: Sequence[LinearStretch],
    names: tuple[str, ...],
    own: Filter | None,
) -> LinearData:
    trends = {}
    for index, recording in enumerate(recordings):
        of_it = [p for p in parts if p.recording == index]
        if of_it:
            t_s = np.concatenate([p.t_s for p in of_it])
            values = np.concatenate([p.values for p in of_it])
            middle_s = float(t_s.mean())
            slope = (t_s - middle_s) @ values / float(((t_s - middle_s) ** 2).sum())
            trends[recording.sha256] = Trend(middle_s, tuple(slope.tolist()))
    values = np.concatenate([p.values for p in parts])
    mean = values.mean(axis=0)
    ones = tuple([1.0] * len(names))
    level = LinearData(names, output_transform(names[-1]), tuple(mean.tolist()), ones, trends)
    flat = np.concatenate(
        [level.apply(p.values, p.t_s, recordings[p.recording].sha256) for p in parts]
    )
    std = flat.std(axis=0)
    for name, spread, at in zip(names, std, mean, strict=True):
        if spread <= 1e-9 * max(1.0, abs(at)):
            files = ", ".join(str(r.path) for r in recordings)
            raise RecordingError(f"{files}: {name} is constant ({plain(at, 6)}); leave it out")
    return replace(level, std=tuple(std.tolist()), filter=own)


def _sections(kind: str, order: int, edges_hz: Sequence[float], period_s: float) -> FloatArray:
    rate = 1.0 / period_s
    if kind == "lowpass":
        return np.asarray(signal.butter(order, edges_hz[0], "lowpass", fs=rate, output="sos"))
    return np.asarray(signal.butter(order, list(edges_hz), "bandstop", fs=rate, output="sos"))
