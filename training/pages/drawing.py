"""Figures as data: plots of layers over two axes, which ``static/figures.js`` draws in the page.

Layers are drawn in their order; ``color`` is a name of ``draw.css`` or a number in a series of
curves, ``label`` stands in the key. Their kinds:

- line: y over the plot's ``at``, or over its own x
- points: x, y, text beside each, size in px, mark "|" for a stroke
- cells: x, y and count of squares of ``size``, deeper colours for more samples
- bars: horizontal, x long in the row y, text behind each
- steps: a histogram, y between the edges x
- rule: lines across the plot at each x or y, text at their ends
- area: filled within the outline x, y
- spans: grey, or the colour thinned, between the pairs x

An axis has ``low`` and ``high``, or holds all layers; its ``scale`` is linear, "log", or "symlog"
with a ``linear`` part around 0. ``rows`` are names in place of numbers, the first one on top,
``ticks`` pairs of value and label in place of round numbers; ``falls``: high values stand left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from monitor.base.files.page_parts import embedded
from monitor.base.types import BoolArray, FloatArray

Layer = Mapping[str, Any]
Plot = Mapping[str, Any]
Axis = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Drawing:
    """Plots side by side; ``together`` their cursors and zooms move as one."""

    template: ClassVar = "plots.html"
    plots: Sequence[Plot]
    columns: Sequence[int] = (1,)  # their shares of the width
    together: bool = False

    @property
    def data(self) -> str:
        """The drawing as JSON for a script element."""
        return embedded({"plots": self.plots, "columns": self.columns, "together": self.together})


def axis(label: str = "", **spec: Any) -> Axis:
    """Return an axis, as the module says."""
    return {"label": label} | spec


def plot(
    title: str,
    *layers: Layer,
    x: Axis | None = None,
    y: Axis | None = None,
    at: FloatArray | None = None,
    height: int = 200,
) -> Plot:
    """Return a plot; its title says what its y axis shows.

    at : (n,) x of all lines that have none themselves
    height : of the plot in px
    """
    axes = {"x": x or axis(), "y": y or axis()}
    return {"title": title, "layers": layers, "at": at, "height": height, "digits": 4, **axes}


def layer(kind: str, **values: Any) -> Layer:
    """Return a layer; floats are kept to five digits."""
    return {"kind": kind} | {key: _short(value) for key, value in values.items()}


def histogram(values: FloatArray, bins: int, **style: Any) -> Layer:
    """Return the layer of a histogram of ``values`` (n,)."""
    counts, edges = np.histogram(values, bins)
    return layer("steps", x=edges, y=counts, **style)


def density(x: FloatArray, y: FloatArray, low: float, high: float, **style: Any) -> Layer:
    """Return a layer of squares with the number of points (x, y) in each, 60 a side."""
    edges = np.linspace(low, high, 61)
    counts, *_ = np.histogram2d(x, y, (edges, edges))
    i, j = np.nonzero(counts)
    side = [float(edges[1] - edges[0])] * 2
    return layer("cells", x=edges[i], y=edges[j], count=counts[i, j], size=side, **style)


def unscored(t_s: FloatArray, scored: BoolArray) -> Layer:
    """Return grey where samples (n,) at ``t_s`` are not scored."""
    ends = np.flatnonzero(np.diff([0, *~scored, 0]))
    return layer("spans", x=np.append(t_s, t_s[-1:])[ends].reshape(-1, 2).tolist())


def _short(value: Any) -> Any:
    """Return an array as a list with five digits; anything else as it is."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        return value
    return [float(f"{each:.5g}") for each in value.tolist()]
