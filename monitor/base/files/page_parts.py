"""What pages embed: files of ``monitor/report/static``, hashes for their policy, and data."""

import base64
import hashlib
import json
from importlib.resources import files
from typing import Any, Final

from monitor.base.files.json_text import rounded

DRAWING: Final = ("uplot/uPlot.iife.min.js", "draw.js")
_COMPACT: Final = json.JSONEncoder(allow_nan=False, separators=(",", ":")).encode


def static(*names: str) -> str:
    """Return texts of files in ``monitor/report/static``, one below the other."""
    folder = files("monitor").joinpath("report", "static")
    texts = (folder.joinpath(*name.split("/")).read_text("utf-8") for name in names)
    return "\n".join(text.replace("\r\n", "\n") for text in texts)


def drawing(script: str) -> str:
    """Return a page's script with the library of plots and its licence before it."""
    return "\n".join((f"/*\n{static('uplot/LICENSE')}*/", static(*DRAWING), script))


def policy_hash(text: str) -> str:
    """Return the hash of an element's text for the Content Security Policy."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def embedded(value: Any) -> str:
    """Return JSON that is safe inside a script element; numbers that are not finite are null."""
    try:
        text = _COMPACT(value)
    except (TypeError, ValueError):  # values of numpy, or a number that is not finite
        text = _COMPACT(rounded(value, None))
    return text.replace("<", "\\u003c")
