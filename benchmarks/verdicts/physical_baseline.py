"""The model a user would write first: fuel over air, delayed and smoothed.

phi = gain * stoichiometric ratio * fuel mass / air mass, through one dead time and one lag, the
three constants fitted by least squares on enabled samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from monitor.base.types import FloatArray
from training.greybox.chain import STOICHIOMETRIC
from training.greybox.quantity.dynamics import lag
from training.recordings.recording import Recording
from training.recordings.samples.preparation import enabled_rows


@dataclass(frozen=True, slots=True)
class Baseline:
    """The fitted constants."""

    delay_s: float
    lag_s: float
    gain: float

    def predict(self, recording: Recording) -> FloatArray:
        """Return phi (n,); unknown masses read as stoichiometric."""
        return self.gain * _shaped(recording, self.delay_s, self.lag_s)


def fit_baseline(recordings: Sequence[Recording]) -> Baseline:
    """Return the constants that fit the recordings' enabled samples best."""

    def error(delay_and_lag: FloatArray) -> float:
        squares, count = 0.0, 0
        for recording in recordings:
            x, y = _enabled(recording, *delay_and_lag)
            gain = float(x @ y) / float(x @ x)
            squares += float(((y - gain * x) ** 2).sum())
            count += len(x)
        return squares / count

    starts = [(d, lag_s) for d in (0.1, 0.25, 0.4) for lag_s in (0.05, 0.2)]
    best = min(
        (minimize(error, start, method="Nelder-Mead") for start in starts), key=lambda r: r.fun
    )
    delay_s, lag_s = (float(v) for v in best.x)
    pairs = [_enabled(recording, delay_s, lag_s) for recording in recordings]
    x, y = (np.concatenate(side) for side in zip(*pairs, strict=True))
    return Baseline(delay_s, lag_s, float(x @ y) / float(x @ x))


def _enabled(recording: Recording, delay_s: float, lag_s: float) -> tuple[FloatArray, FloatArray]:
    rows = enabled_rows(recording) & np.isfinite(recording.column("lambda_measured"))
    phi = 1.0 / recording.column("lambda_measured")[rows]
    return _shaped(recording, delay_s, lag_s)[rows], phi


def _shaped(recording: Recording, delay_s: float, lag_s: float) -> FloatArray:
    period_s = recording.period_ns / 1e9
    air, fuel = recording.column("air_mass_mg"), recording.column("fuel_mass_mg")
    ratio = np.nan_to_num(STOICHIOMETRIC * fuel / air, nan=1.0)
    ticks = np.arange(len(ratio))
    late = np.interp(ticks - max(delay_s, 0.0) / period_s, ticks, ratio)
    return np.asarray(lag(late, max(lag_s, 1e-3), period_s))
