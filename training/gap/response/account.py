"""What the reading does differently, in words and figures an engineer can check."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.response.equations import Held
from training.gap.response.families import PASTS_S
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import delayed, lag

DELAYS_S: Final = tuple(np.arange(0.0, 1.51, 0.1).tolist())
LAGS_S: Final = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0)
LONG_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class ResponseAccount:
    """The reading of the new runs against that of a healthy vehicle, three constants."""

    gain: float
    delay_s: float
    lag_s: float

    @property
    def words(self) -> str:
        """Return the constants that differ from those of a healthy vehicle."""
        parts = [f"with a gain of {self.gain:.2f}"]
        parts += [f"{self.delay_s:.1f} s later"] if self.delay_s > 0.0 else []
        parts += [f"through a lag of {self.lag_s:.1f} s"] if self.lag_s > 0.0 else []
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class ResponseCurve:
    """What a driver adds to the reading, straight between knots."""

    x: FloatArray  # (p,) in the driver's unit
    y: FloatArray  # (p,) about their mean, in the model's unit

    @property
    def slope(self) -> float:
        """Return the slope of the straight line through the curve."""
        return float(np.polyfit(self.x, self.y, 1)[0])

    @property
    def straight(self) -> float:
        """Return how much of the curve's variance the straight line has."""
        rest = self.y - np.polyval(np.polyfit(self.x, self.y, 1), self.x)
        return 1.0 - float(rest.var() / max(float(self.y.var()), 1e-300))


def response_of(new: Sequence[Comparison], healthy: Sequence[Comparison]) -> ResponseAccount:
    """Return gain, delay and lag that bring the healthy reading nearest to the new one.

    healthy : beside the same reading, whose gain is 1: a reading that is known badly has less
    """
    tried = {both: _nearest(new, *both) for both in product(DELAYS_S, LAGS_S)}
    (delay_s, lag_s), (gain, _) = min(tried.items(), key=lambda each: each[1][1])
    usual, _ = _nearest(healthy, 0.0, 0.0)
    return ResponseAccount(gain / usual, delay_s, lag_s)


def _nearest(runs: Sequence[Comparison], delay_s: float, lag_s: float) -> tuple[float, float]:
    """Return the gain of a late and slow healthy reading, and the sum of squares that it leaves."""
    late = [lag(delayed(r.phi_predicted, delay_s / r.period_s), lag_s, r.period_s) for r in runs]
    made = np.concatenate([x[r.scored] for r, x in zip(runs, late, strict=True)])
    measured = np.concatenate([r.phi_measured[r.scored] for r in runs])
    x, y = made - made.mean(), measured - measured.mean()
    gain = float(x @ y) / max(float(x @ x), 1e-300)
    return gain, float(((y - gain * x) ** 2).sum())


def past_s(held: Held, period_s: float) -> float:
    """Return the time in which half of a driver's step passes by its lags' weights, inf if long."""
    t = period_s * np.arange(max(int(np.ceil(LONG_S / period_s)), 2))
    step = sum(
        w * (lag(np.r_[0.0, np.ones(len(t) - 1)], s, period_s) - 1.0)
        for w, s in zip(held.coefficients, PASTS_S, strict=True)
    )
    after = np.flatnonzero(np.abs(step[1:]) <= 0.5 * abs(step[1]))
    return float(t[after[0]]) if len(after) else np.inf
