"""Pictures in the offline tools' pages."""

import base64
import re

import pytest
from matplotlib.figure import Figure

from training.pages.figure import figure


def _svg(drawn: Figure) -> str:
    (data,) = re.findall(r"base64,([^\"]+)", figure(drawn, "a caption"))
    return base64.b64decode(data).decode()


@pytest.mark.parametrize("name", ["drive_$date_$vin.csv", "nmot$w_$", r"a$\foo$b"])
def test_dollars_in_names_are_shown_as_they_are(name: str) -> None:
    # GIVEN a picture with such a name wherever names stand, one axis logarithmic
    drawn = Figure(layout="constrained")
    axes = drawn.subplots()
    axes.barh([0, 1], [1.0, 100.0], label=name)
    axes.set_yticks([0, 1], labels=[name, "other"])
    axes.set_xscale("log")
    axes.set_title(name)
    axes.legend()
    # WHEN it is drawn
    svg = _svg(drawn)
    # THEN the names are there in full, and the logarithmic axis has numbers
    assert svg.count(f"<!-- {name} -->") == 3
    assert "<!-- 10 -->" in svg


def test_ticks_of_logarithmic_axes_are_numbers_in_full() -> None:
    # GIVEN an axis over many powers of ten, and one within a power
    drawn = Figure()
    drawn.subplots().plot([1e-5, 2e4], [2.0, 8.0])
    drawn.axes[0].set(xscale="log", yscale="log", ylim=(2.0, 8.0))
    # WHEN it is drawn
    ticks = re.findall(r"<!-- (.*?) -->", _svg(drawn))
    # THEN no tick is a power, and both axes have ticks
    assert {"0.0001", "10,000", "2", "5"} <= set(ticks)
    assert not [t for t in ticks if "e" in t or "^" in t]
