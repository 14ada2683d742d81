"""The scaling of a training: zero mean and unit variance, and the ranges of the signals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from monitor.base.counts import plain
from monitor.base.errors import RecordingError
from monitor.base.signals import unit_of
from monitor.base.types import FloatArray
from monitor.model.card import Channel
from monitor.model.step import PHI_MAX

if TYPE_CHECKING:
    from training.recordings.recording import Recording


MARGIN = {"phi": 0.05, "none": 0.3}  # of the trained range, by which signals may leave it
NEAR_END = 0.05  # of the output's range; a reading that moves passes it on its way to an end
LEAST_AT_END = 0.002  # of the readings; a single peak is no end


@dataclass(frozen=True, slots=True)
class Scaling:
    """Affine maps to zero mean and unit variance."""

    u_mean: FloatArray
    u_std: FloatArray
    u_low: FloatArray  # inputs are clipped to this range first
    u_high: FloatArray
    y_mean: float
    y_std: float
    y_low: float  # model units: phi or the output itself
    y_high: float

    def scale_u(self, u: FloatArray) -> FloatArray:
        """Return scaled inputs (n, k)."""
        return np.asarray((np.clip(u, self.u_low, self.u_high) - self.u_mean) / self.u_std)

    def scale_y(self, y: FloatArray | float) -> FloatArray:
        """Return scaled model units."""
        return np.asarray((np.clip(y, self.y_low, self.y_high) - self.y_mean) / self.y_std)

    @property
    def y_scaled_limits(self) -> tuple[float, float]:
        """The output's range in scaled units."""
        return float(self.scale_y(self.y_low)), float(self.scale_y(self.y_high))

    def unscale_y(self, y: FloatArray) -> FloatArray:
        """Return model units."""
        return np.asarray(y * self.y_std + self.y_mean)


def scaling_of(
    u: FloatArray,
    y: FloatArray,
    transform: str,
    inputs: Sequence[str],
    recordings: Sequence["Recording"],
) -> Scaling:
    """Return the scaling of inputs (n, k) and output (n,); it leaves ``MARGIN`` round their range.

    Raises RecordingError if a signal is constant.
    """
    std = u.std(axis=0)
    for name, spread, mean in zip(inputs, std, u.mean(axis=0), strict=True):
        if spread <= 1e-9 * max(1.0, abs(mean)):
            files = ", ".join(str(r.path) for r in recordings)
            raise RecordingError(
                f"{files}: input {name} is constant ({plain(mean, 6)}); leave it out"
            )
    if y.std() <= 1e-9:
        raise RecordingError(f"{recordings[0].path}: the output is constant ({plain(y.mean(), 6)})")
    low, high = u.min(axis=0), u.max(axis=0)
    share = MARGIN[transform]
    margin = share * (high - low)
    y_low, y_high = (0.0, PHI_MAX) if transform == "phi" else _output_range(y, share)
    return Scaling(
        u_mean=u.mean(axis=0),
        u_std=std,
        u_low=low - margin,
        u_high=high + margin,
        y_mean=float(y.mean()),
        y_std=float(y.std()),
        y_low=y_low,
        y_high=y_high,
    )


def _output_range(y: FloatArray, share: float) -> tuple[float, float]:
    """Return the output's range, with a margin at the ends at which no sensor stands.

    A sensor stands at an end of its range if more readings equal the end than come close to it.
    """
    low, high = float(y.min()), float(y.max())
    margins = []
    for end in (low, high):
        at = int((y == end).sum())
        near = int((np.abs(y - end) <= NEAR_END * (high - low)).sum()) - at
        stands = at > max(near, LEAST_AT_END * len(y))
        margins.append(0.0 if stands else share * (high - low))
    return low - margins[0], high + margins[1]


def channel_of(name: str, values: FloatArray) -> Channel:
    """Return the card's entry of a signal with these training values (n,)."""
    low, high = np.percentile(values, [0.1, 99.9])
    return Channel(
        name=name,
        unit=unit_of(name),
        minimum=float(values.min()),
        maximum=float(values.max()),
        percentile_0_1=float(low),
        percentile_99_9=float(high),
    )
