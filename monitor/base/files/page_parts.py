"""What pages embed: files of ``monitor/report/static``, hashes for their policy, and data."""

import base64
import hashlib
import json
import math
from collections.abc import Mapping
from importlib.resources import files
from typing import Any, Final

import numpy as np

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
        text = _COMPACT(_finite(value))
    return text.replace("<", "\\u003c")


def _finite(value: Any) -> Any:
    """Turn values of numpy into Python's; numbers that are not finite become null."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
