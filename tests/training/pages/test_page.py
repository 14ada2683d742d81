"""The frame of every page, and its tables."""

import base64
import hashlib
import json
import math
import re

import numpy as np
import pytest

from monitor import __version__
from training.pages import page as frame
from training.pages.drawing import Drawing, layer, plot
from training.pages.page import page, part
from training.pages.table import PageTable


@pytest.fixture(autouse=True)
def templates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the body of a page be its ``body`` value."""
    jinja2 = pytest.importorskip("jinja2")
    environment = frame._environment()
    body = jinja2.DictLoader(
        {
            "body.html": "{% for t in titles %}<h2>{{ t }}</h2>{% endfor %}",
            "plot.html": "{{ figure(drawn, 'a <caption>') }}",
        }
    )
    monkeypatch.setattr(environment, "loader", jinja2.ChoiceLoader([body, environment.loader]))


def digest(tag: str, text: str) -> str:
    """Return the policy's hash of the one element with such a tag."""
    (inside,) = re.findall(f"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
    return f"'sha256-{base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()}'"


def test_a_page_without_plots_runs_no_script_and_its_style_is_the_one_it_allows() -> None:
    text = page("body.html", "A <title>", titles=[], verdict="v", confidence="c")
    assert f"default-src 'none'; style-src {digest('style', text)}" in text
    assert "script" not in text and "style=" not in text
    assert "<h1>A &lt;title&gt;</h1>" in text
    assert f"o2-monitor {__version__}" in text


def test_a_page_with_a_plot_runs_the_script_that_it_allows_and_its_names_stay_text() -> None:
    # GIVEN a plot with a name that would end the element of its data
    drawn = Drawing([plot("</script><b>", layer("points", x=np.array([math.nan]), y=[1.0]))])
    # WHEN a page shows it
    text = page("plot.html", "T", drawn=drawn, verdict="v", confidence="c")
    # THEN its script is the one that the policy names, and the data are JSON without markup
    assert f"script-src {digest('script', text)}" in text
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', text)
    (read,) = json.loads(data)["plots"]
    assert read["title"] == "</script><b>"
    assert read["layers"] == [{"kind": "points", "x": [None], "y": [1.0]}]
    assert "a &lt;caption&gt;" in text


def test_a_long_page_has_a_list_of_contents() -> None:
    titles = ["one", "two & a half", "three", "four", "five"]
    text = page("body.html", "Long", titles=titles, verdict="v", confidence="c")
    assert '<a href="#part2">two &amp; a half</a>' in text
    assert '<h2 id="part2">two &amp; a half</h2>' in text
    assert "<nav>" not in page("body.html", "Short", titles=titles[:4], verdict="v", confidence="c")


def test_verdict_confidence_and_warnings_stand_first() -> None:
    given = {"kind": "bad", "warnings": ["<w>"], "titles": ["one"]}
    text = page("body.html", "T", verdict="a > b", confidence="high", **given)
    first = ('"verdict bad">a &gt; b', "Confidence: high", "&lt;w&gt;", "<h2", "<footer>")
    places = [text.index(t) for t in first]
    assert places == sorted(places)


def shown(table: PageTable) -> str:
    return table.__html__()


def test_numbers_stand_right_and_words_left() -> None:
    # GIVEN a column of numbers with a unit, a missing one and a large one, and one of words
    table = PageTable(part, "signal", "time", "verdict")
    table.row("flow", "3.5 s", "better")
    table.row("7 bar", "–", "")
    table.row("speed", 12345, "2 of 3, worse")
    # WHEN it is put into a page
    # THEN only the column of numbers stands right, its head, too; the first column names the row
    assert table.columns == ["", "n", ""]
    assert '<th class="n">time</th>' in shown(table)
    assert '<td class="n">12,345</td>' in shown(table)
    assert '<td>7 bar</td><td class="n">–</td><td></td>' in shown(table)


def test_cells_are_escaped_and_a_chosen_row_is_set_off() -> None:
    table = PageTable(part, "a <b>", rows=[("x & y",)])
    table.row("<i>", chosen=True)
    assert "<th>a &lt;b&gt;</th>" in shown(table)
    assert "<tr><td>x &amp; y</td></tr>" in shown(table)
    assert '<tr class="chosen"><td>&lt;i&gt;</td></tr>' in shown(table)


def test_long_texts_have_room_and_every_table_scrolls() -> None:
    table = PageTable(part, rows=[("short", "a text that is longer than a cell of a phone")])
    assert table.columns == ["", "long"]
    assert shown(table).startswith('<div class="scroll">')
