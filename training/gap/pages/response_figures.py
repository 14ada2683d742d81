"""Pictures of in what runs differ from those of the healthy vehicle."""

from matplotlib.figure import Figure

from training.gap.response.account import ResponseCurve
from training.gap.response.drivers import UNITS, WORDS
from training.pages.figure import drawing
from training.pages.numbers import with_unit, words


def label(name: str) -> str:
    """Return a signal's words with its unit."""
    return with_unit(WORDS.get(name, words(name)), UNITS.get(name))


def added_figure(curve: ResponseCurve, driver: str, unit: str) -> Figure:
    """Draw what a driver adds to the reading."""
    figure, axes = drawing(2.6)
    axes.plot(curve.x, curve.y, color="C0", linewidth=1.2)
    axes.axhline(0.0, color="0.5", linewidth=0.7)
    axes.set(xlabel=label(driver), ylabel=f"added [{unit}]")
    return figure
