"""Self-contained HTML pages of the offline tools: nothing is loaded from elsewhere."""

import base64
import html
from collections.abc import Sequence
from io import BytesIO
from typing import Final

import matplotlib as mpl
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import NullFormatter

_POWER: Final = r"\mathdefault"  # in matplotlib's own labels of logarithmic axes

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>{title}</title><style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }}
table {{ border-collapse: collapse; margin: 1em 0; display: block; overflow-x: auto; }}
td, th {{ border-bottom: 1px solid #ccc; padding: .2em .8em; text-align: left; }}
td.n {{ text-align: right; font-variant-numeric: tabular-nums; }}
tr.chosen td {{ font-weight: 600; background: #eef4ff; }}
figure {{ margin: 1.5em 0; }} img {{ max-width: 100%; }} .warning {{ color: #a33; }}
figcaption, .note {{ color: #555; }}
nav a {{ margin-right: 1em; }}
.verdict {{ font-size: 1.15em; padding: .6em 1em; }}
.verdict {{ border-left: .3em solid #57a; background: #f3f6fa; }}
.sensor_fault_suspected {{ border-color: #a33; }} summary {{ cursor: pointer; color: #555; }}
:root {{ color-scheme: light dark; }}
@media (prefers-color-scheme: dark) {{
  td, th {{ border-color: #555; }} tr.chosen td {{ background: #23324d; }}
  figcaption, .note, summary {{ color: #aaa; }} .warning {{ color: #f99; }}
  .verdict {{ background: #222a35; }}
}}
</style></head><body><h1>{title}</h1>
{body}
</body></html>
"""


def page(title: str, body: str) -> str:
    """Return a whole page; ``body`` is HTML."""
    return _PAGE.format(title=html.escape(title), body=body)


def paragraph(text: str, kind: str = "") -> str:
    """Return an escaped paragraph; ``kind`` is its class: warning, note or none."""
    return f'<p class="{kind}">{html.escape(text)}</p>' if kind else f"<p>{html.escape(text)}</p>"


def table(
    rows: Sequence[Sequence[str]], head: Sequence[str] = (), chosen: int | None = None
) -> str:
    """Return a table of escaped cells; numbers but those of the first column are set right.

    chosen : row to set off
    """
    cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    lines = [f"<tr>{cells}</tr>"] if head else []
    for index, row in enumerate(rows):
        mark = ' class="chosen"' if index == chosen else ""
        cells = "".join(_cell(c, is_first=i == 0) for i, c in enumerate(row))
        lines.append(f"<tr{mark}>{cells}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _cell(text: str, *, is_first: bool) -> str:
    is_text = is_first or text[:1].isalpha()
    return f"<td>{html.escape(text)}</td>" if is_text else f'<td class="n">{html.escape(text)}</td>'


def picture(figure: Figure, caption: str) -> str:
    """Return the figure as embedded SVG; the same figure gives the same bytes."""
    buffer = BytesIO()
    texts = [text for text in figure.findobj(Text) if isinstance(text, Text)]
    has_dollars = any("$" in t.get_text() and _POWER not in t.get_text() for t in texts)
    if has_dollars:
        _take_no_formulas(figure, texts)
    with mpl.rc_context({"svg.hashsalt": "o2-monitor", "text.parse_math": not has_dollars}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    text = html.escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def _take_no_formulas(figure: Figure, texts: Sequence[Text]) -> None:
    """Show dollars as they are: names of files and signals may hold some."""
    for text in texts:
        text.set_parse_math(False)
    for axis in figure.findobj(Axis):
        if isinstance(axis, Axis) and axis.get_scale() != "linear":
            axis.set_major_formatter("{x:g}")  # its powers are formulas
            axis.set_minor_formatter(NullFormatter())
