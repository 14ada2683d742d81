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


def test_logarithmic_axes_have_powers_otherwise() -> None:
    drawn = Figure()
    drawn.subplots().loglog([1.0, 100.0], [1.0, 100.0])
    assert r"$\mathdefault{10^{1}}$" in _svg(drawn)
