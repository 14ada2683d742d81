"""Elements of the report in HTML. Every value from outside passes through ``text``."""

import html
import math
import re
from collections.abc import Iterable, Mapping, Sequence

from monitor.base.counts import plain


def text(value: object) -> str:
    """Return any value as text that is safe in HTML."""
    return html.escape(str(value))


def number(value: object) -> str:
    """Return a number with four digits, a dash for none."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return plain(value).replace("-", "−") if math.isfinite(value) else "–"
    return text(value)


def path(path: object) -> str:
    """Return a path as HTML that may break after separators."""
    return re.sub(r"([/\\_])", r"\1<wbr>", text(path))


def table(rows: Sequence[Mapping[str, str]], css_class: str = "", *, head: bool = True) -> str:
    """Return a table of rows, each HTML by the name of its column; "" without a row.

    head : whether the names stand above; on a phone the class ``cards`` sets them beside the cells
    """
    if not rows:
        return ""
    names = "".join(f"<th>{text(name)}</th>" for name in rows[0])
    cell = '<td data-label="{}"><div>{}</div></td>'.format
    body = "".join(f"<tr>{''.join(cell(text(k), v) for k, v in row.items())}</tr>" for row in rows)
    above = f"<thead><tr>{names}</tr></thead>" if head else ""
    return f'<table class="{css_class}">{above}<tbody>{body}</tbody></table>'


def term_list(facts: Iterable[tuple[str, str]]) -> str:
    """Return a list of (term, HTML)."""
    items = "".join(f"<div><dt>{key}</dt><dd>{value}</dd></div>" for key, value in facts)
    return f"<dl>{items}</dl>"
