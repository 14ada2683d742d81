"""Shows the docstrings of this project on the site.

A docstring names parameters as ``name, other : text``, with further lines indented, and says
``Raises …`` in prose. Here they become lists and paragraphs of Markdown.
"""

import re
from itertools import groupby
from typing import Any, Final

import griffe

PARAMETER: Final = re.compile(r"(?P<names>[A-Za-z_]\w*(?:, [A-Za-z_]\w*)*) : (?P<text>.*)")


class Docstrings(griffe.Extension):
    """Turns each docstring into Markdown when it is read."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring of a package, class, function or attribute."""
        if obj.docstring is not None:
            obj.docstring.value = markdown(obj.docstring.value)


def markdown(docstring: str) -> str:
    """Return the docstring with a list of its parameters, and examples as code."""
    parts = []
    for is_example, lines in groupby(_with_kind(docstring.splitlines()), lambda each: each[0]):
        text = [line for _, line in lines]
        parts += ["", "```pycon", *text, "```", ""] if is_example else _prose(text)
    return "\n".join(parts)


def _with_kind(lines: list[str]) -> list[tuple[bool, str]]:
    """Return each line with whether it belongs to an example: from ``>>>`` to an empty line."""
    kinds, inside = [], False
    for line in lines:
        inside = line.lstrip().startswith(">>>") or (inside and bool(line.strip()))
        kinds.append((inside, line))
    return kinds


def _prose(lines: list[str]) -> list[str]:
    """Return prose whose parameters are items of a list and whose ``Raises`` is a paragraph."""
    out: list[str] = []
    for line in lines:
        match = PARAMETER.fullmatch(line)
        if match:
            names = ", ".join(f"`{name}`" for name in match["names"].split(", "))
            start = [] if out and out[-1].startswith((" ", "- ")) else [""]
            out += [*start, f"- {names}: {match['text']}"]
        elif line.startswith(("Raises ", "Source: ")):
            out += ["", line]
        elif line.startswith("    ") or not line.strip():
            out.append(line)
        elif out and out[-1].startswith("- "):  # prose right behind the list
            out += ["", line]
        else:
            out.append(line)
    return out
