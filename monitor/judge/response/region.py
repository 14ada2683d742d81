"""The joint region of the inputs in which a model was learned, window by window.

A window's point is the mean and the standard deviation of each input in it. A window far from
every point that was learned is no evidence: each input may lie within its own range, and yet the
model has seen no such driving. Inputs that a faulty sensor moves by itself do not count: through
the controller, a fault would leave the region and never be judged.

Source: Gonzalez, Clustering to minimize the maximum intercluster distance, Theoretical Computer
Science 38 (1985) (points that cover the others).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Region:
    """Learned points, thinned so that each healthy one lies near one that is kept."""

    names: tuple[str, ...]  # the model's first inputs, whose means, then spreads, make a point
    scale: FloatArray  # (n,) unit of each coordinate
    points: FloatArray  # (m, n) in these units
    most: float  # distance from the nearest point beyond which a window counts no longer
    ignored: tuple[str, ...] = ()  # inputs that do not count in the distance

    def beyond(self, inputs: FloatArray) -> FloatArray:
        """Return the distance of windows from the region over ``most``, (w,).

        inputs : (w, n, n_inputs) of the windows' samples; those of effects that were added to the
            model after the region was learned come last and do not count
        """
        counts = counted(self.names, self.ignored)
        own = points_of(inputs[:, :, : len(self.names)])
        scaled, points = (own / self.scale)[:, counts], self.points[:, counts]
        apart = [np.square(points - each).sum(axis=1).min() for each in scaled]
        return np.asarray(np.sqrt(apart) / self.most, dtype=np.float64)

    def to_card(self) -> dict[str, Any]:
        """Return the region for a model card."""
        return {
            "names": list(self.names),
            "scale": self.scale.tolist(),
            "points": self.points.tolist(),
            "most": self.most,
        }

    @classmethod
    def from_card(
        cls, data: Mapping[str, Any], where: str, ignored: Sequence[str] = ()
    ) -> "Region | None":
        """Return the region of a model card, None if it holds none.

        ignored : inputs that do not count in the distance
        Raises ModelError naming the file if the card's region is none.
        """
        if not data:
            return None
        try:
            names = tuple(str(name) for name in data["names"])
            scale = np.array(data["scale"], dtype=np.float64)
            points, most = np.array(data["points"], dtype=np.float64), float(data["most"])
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"{where}: the model card's region cannot be read: {error}") from None
        n = 2 * len(names)
        is_whole = scale.shape == (n,) and points.ndim == 2 and points.shape[1:] == (n,)
        if not (is_whole and n and len(points) and (scale > 0.0).all() and most > 0.0):
            raise ModelError(f"{where}: the model card's region has a wrong shape or a scale of 0")
        return cls(names, scale, points, most, tuple(ignored))


def counted(names: Sequence[str], ignored: Sequence[str]) -> BoolArray:
    """Return which coordinates of a point count in the distance, (2 n_inputs,).

    >>> counted(("speed", "controller"), ["controller"]).tolist()
    [True, False, True, False]
    """
    return np.tile([name not in ignored for name in names], 2)


def points_of(inputs: FloatArray) -> FloatArray:
    """Return the points, (w, 2 n_inputs), of windows' inputs, (w, n, n_inputs).

    >>> points_of(np.array([[[1.0, 5.0], [3.0, 5.0]]])).tolist()
    [[2.0, 5.0, 1.0, 0.0]]
    """
    return np.concatenate([inputs.mean(axis=1), inputs.std(axis=1)], axis=1)
