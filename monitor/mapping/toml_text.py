"""Texts from databases, safe in a TOML file."""

import json


def quoted(text: str) -> str:
    """Return the text as a TOML string.

    >>> quoted('a"b')
    '"a\\\\"b"'
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def plain(text: str) -> str:
    """Return the text on one line that may stand in a comment."""
    return "".join(c if c.isprintable() else " " for c in text)
