"""The way from the engine to the sensor: dead time, then one lag for mixing and sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from training.greybox.chain import STOICHIOMETRIC
from training.greybox.fit.comparison import Comparison

DEAD_TIMES_S = np.arange(0.0, 1.01, 0.05)
LAGS_S = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True, slots=True)
class Transport:
    """Dead time per recording and sample, and the lag behind it."""

    dead_time_s: tuple[FloatArray, ...]
    lag_s: float
    source: str  # how it was obtained, for the report

    def move(self, values: FloatArray, recording: int, period_s: float) -> FloatArray:
        """Return (n,) or (n, k) ``values`` at the engine as they reach the sensor."""
        return transported(values, self.dead_time_s[recording], self.lag_s, period_s)


def transported(
    values: FloatArray, dead_time_s: FloatArray, lag_s: float, period_s: float
) -> FloatArray:
    """Return ``values`` (n,) or (n, k) after a dead time (n,) and a lag of first order."""
    ticks = np.arange(len(values), dtype=np.float64)
    at = np.clip(ticks - dead_time_s / period_s, 0.0, len(values) - 1.0)
    low = np.minimum(at.astype(np.int64), max(len(values) - 2, 0))
    part = (at - low).reshape(-1, *(1,) * (values.ndim - 1))
    late = values[low] * (1.0 - part) + values[np.minimum(low + 1, len(values) - 1)] * part
    keep = float(np.exp(-period_s / lag_s)) if lag_s > 0.0 else 0.0
    smooth, _ = lfilter([1.0 - keep], [1.0, -keep], late, axis=0, zi=keep * late[:1])
    return np.asarray(smooth)


def find_transport(recordings: Sequence[Comparison]) -> Transport | None:
    """Return the chain's transport, or one estimated from fuel over air; None if neither is there.

    The estimate takes the dead time and lag at which fuel over air comes closest to measured phi.
    """
    given = [r.dead_time_s for r in recordings if r.dead_time_s is not None]
    if len(given) == len(recordings):
        lags = [r.lag_s or 0.0 for r in recordings]
        return Transport(tuple(given), float(np.median(lags)), "the model's own chain")
    needed = ("fuel_mass_mg", "air_mass_mg")
    if not all(name in r.signals for r in recordings for name in needed):
        return None
    errors = {
        (d, lag): sum(_misfit(r, d, lag) for r in recordings)
        for d, lag in product(DEAD_TIMES_S, LAGS_S)
    }
    dead_s, lag_s = min(errors, key=lambda key: errors[key])
    source = (
        f"fuel over air comes closest to the sensor after {dead_s:.2f} s and a lag of {lag_s:g} s"
    )
    return Transport(tuple(np.full(len(r.residual), dead_s) for r in recordings), lag_s, source)


def like(transport: Transport | None, recordings: Sequence[Comparison]) -> Transport | None:
    """Return the transport for other recordings: from their chain, else the same dead time."""
    if transport is None:
        return None
    typical_s = float(np.median(np.concatenate(transport.dead_time_s)))
    dead_time_s = tuple(
        np.full(len(r.residual), typical_s) if r.dead_time_s is None else r.dead_time_s
        for r in recordings
    )
    return Transport(dead_time_s, transport.lag_s, transport.source)


def _misfit(r: Comparison, dead_s: float, lag_s: float) -> float:
    """Return the squared error of measured phi that fuel over air leaves, slope and mean fitted."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = STOICHIOMETRIC * r.signals["fuel_mass_mg"] / r.signals["air_mass_mg"]
    ratio = np.clip(np.nan_to_num(ratio, nan=1.0, posinf=1.0, neginf=1.0), 0.0, 2.0)
    late = transported(ratio, np.full(len(ratio), dead_s), lag_s, r.period_s)[r.scored]
    phi = r.phi_measured[r.scored]
    if len(phi) < 2:
        return 0.0
    late, phi = late - late.mean(), phi - phi.mean()
    power = float(late @ late)
    slope = float(late @ phi) / power if power > 0.0 else 0.0
    return float(((phi - slope * late) ** 2).sum())
