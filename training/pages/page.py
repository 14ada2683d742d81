"""The frame of every page and the templates in it; a page loads nothing from elsewhere."""

import re
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from monitor import __version__
from monitor.base.counts import counted
from monitor.base.files.page_parts import drawing, policy_hash, static
from training.pages import numbers
from training.pages.drawing import Drawing
from training.pages.heat import Heat
from training.pages.table import PageTable

if TYPE_CHECKING:
    from jinja2 import Environment, Template

LONG: Final = 5  # headings from which a page has a list of contents
PLOTS: Final = '<figure class="plots">'
_HEADING: Final = re.compile(r'(?<!<summary>)<h2(?: id="([^"]+)")?>(.*?)</h2>', re.DOTALL)


def page(
    template: "str | Template",
    title: str,
    *,
    verdict: str,
    confidence: str,
    kind: str = "",
    **values: Any,
) -> str:
    """Return a whole page: title, verdict, contents if it is long, body, footer.

    template : of the body, below ``templates/`` or from ``template_of``
    verdict : sentences with the verdict and its reason; every page has one
    confidence : how sure the verdict is and why, behind "Confidence:"
    kind : class of the verdict: good, bad, or a name of its own
    values : for the body's template; ``warnings`` stand below the verdict, ``footer`` holds lines
        about models, code and recordings
    """
    headings: list[tuple[str, str]] = []

    def anchored(found: re.Match[str]) -> str:
        headings.append((found[1] or f"part{len(headings) + 1}", found[2]))
        return f'<h2 id="{headings[-1][0]}">{found[2]}</h2>'

    warnings, footer = values.pop("warnings", ()), values.pop("footer", ())
    body = _HEADING.sub(anchored, part(template, **values))
    style = static("uplot/uPlot.min.css", "draw.css") + _static("page.css")
    script = drawing(_static("figures.js")) if PLOTS in body else ""
    return part(
        "page.html",
        title=title,
        verdict=verdict,
        confidence=confidence,
        kind=kind,
        warnings=warnings,
        contents=[(name, _html(text)) for name, text in headings if len(headings) >= LONG],
        body=_html(body),
        footer=(*footer, f"o2-monitor {__version__}"),
        style=_html(style),
        script=_html(script),
        hash=policy_hash,
    )


def part(template: "str | Template", /, **values: Any) -> str:
    """Return a part of a page as HTML that other templates do not escape again."""
    return _html(_environment().get_template(template).render(values))


def figure(drawn: Drawing | Heat, caption: str) -> str:
    """Return a figure with its caption as HTML."""
    return part(drawn.template, drawn=drawn, caption=caption)


def template_of(path: Path) -> "Template":
    """Return the template of a file outside of this package."""
    return _environment().from_string(path.read_text(encoding="utf-8"))


def breakable(name: str) -> str:
    """Return a file's name as HTML that may wrap behind its underscores and slashes.

    >>> str(breakable("a_b"))
    'a_<wbr>b'
    """
    from markupsafe import escape  # noqa: PLC0415

    return _html(str(escape(name)).replace("_", "_<wbr>").replace("/", "/<wbr>"))


def _static(name: str) -> str:
    return files("training.pages").joinpath("static", name).read_text("utf-8")


def _html(text: str) -> str:
    from markupsafe import Markup  # noqa: PLC0415

    return Markup(text)


@cache
def _environment() -> "Environment":
    """Return the templates with all that they may use; Jinja2 is loaded only now."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415

    environment = Environment(
        loader=PackageLoader("training.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        extensions=["jinja2.ext.do"],
        finalize=numbers.separated,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    names = "form fixed short p_value signed count percent with_unit"
    for name in (*names.split(), "unit_of", "words", "unbroken"):
        environment.filters[name] = getattr(numbers, name)
    environment.filters |= {"yes": lambda x: "yes" if x else "no", "sha": _sha, "counted": counted}
    environment.filters["file_name"] = lambda path: Path(path).name
    environment.globals |= {"table": partial(PageTable, part), "figure": figure}
    return environment


def _sha(text: str, letters: int = 12) -> str:
    return _html("<code>{}</code>").format(text[:letters])
