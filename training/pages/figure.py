"""One style of figures for every page: matplotlib to SVG within the page."""

import base64
import math
from decimal import Decimal
from io import BytesIO
from typing import Any, Final, Literal

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from training.pages.page import part

WIDTH: Final = 9.0  # inches, as wide as the text
MEASURED: Final = "0.2"
LIMIT: Final = "0.5"
COLOURS: Final = (
    *("#1f5fa8", "#d2691e", "#3b8a4e", "#c0392b", "#8a5aa8"),
    *("#8c6d46", "#d77fb4", "#7f7f7f", "#b5a316", "#23a6b8"),
)
STYLE: Final[Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "figure.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=COLOURS),
    "text.parse_math": False,  # names of files and signals may hold dollars
    "svg.hashsalt": "o2-monitor",
}
mpl.rcParams.update(STYLE)  # figures are drawn for pages only


def drawing(height: float, width: float = WIDTH) -> tuple[Figure, Axes]:
    """Return a figure of one panel; sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def panels(
    number: int, columns: int, *, height: float, extra: float = 0.0, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure of so many panels in rows; ``shared`` as of ``Figure.subplots``.

    height : of a row in inches
    extra : of the figure beside its rows, in inches
    """
    rows = -(-max(number, 1) // columns)
    figure = Figure(figsize=(WIDTH, height * rows + extra), layout="constrained")
    grid = list(figure.subplots(rows, columns, squeeze=False, **shared).ravel())
    for axes in grid[number:]:
        axes.set_axis_off()
    for axes in grid[max(number - columns, 0) : number]:
        axes.tick_params(
            labelbottom=True
        )  # the lowest panel of a column may not be in the last row
    return figure, grid[:number]


def legend(axes: Axes, where: Literal["above", "beside"] = "above", columns: int = 4) -> None:
    """Put the legend where it hides nothing: above the panel's right end, or beside it."""
    if where == "above":
        axes.legend(ncols=columns, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    else:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def figure(drawn: Figure, caption: str) -> str:
    """Return the figure as HTML with embedded SVG; the same figure gives the same bytes."""
    buffer = BytesIO()
    for axis in (axis for axes in drawn.axes for axis in (axes.xaxis, axes.yaxis)):
        if axis.get_scale() in ("log", "symlog"):
            _show_in_full(axis)
    drawn.savefig(buffer, format="svg", metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return part("figure.html", data=data, caption=caption)


def _show_in_full(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers, 0.001 and 1,000 instead of powers."""
    low, high = axis.get_view_interval()
    has_power = low <= 0.0 or math.floor(math.log10(high)) >= math.ceil(math.log10(low))
    axis.set_major_formatter(FuncFormatter(_in_full))
    axis.set_minor_formatter(NullFormatter() if has_power else FuncFormatter(_in_full))


def _in_full(value: float, _: int | None = None) -> str:
    """Return a number without an exponent.

    >>> _in_full(1e-5), _in_full(2e4)
    ('0.00001', '20,000')
    """
    return f"{Decimal(f'{value:.6g}'):,f}".replace("-", "\N{MINUS SIGN}")
