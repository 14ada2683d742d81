"""Results as JSON."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.files.outputs import write_text


def write_json(path: Path, result: Mapping[str, Any]) -> None:
    """Write a result as JSON; the same result gives the same bytes."""
    write_text(path, json.dumps(rounded(result), indent=1, allow_nan=False) + "\n")


def rounded(value: Any, digits: int | None = 9) -> Any:
    """Turn values of numpy into Python's; numbers that are not finite become null.

    digits : decimals to which floats are rounded; None leaves them as they are
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        known = value if math.isfinite(value) else None
        return known if known is None or digits is None else round(known, digits)
    if isinstance(value, Mapping):
        return {str(k): rounded(v, digits) for k, v in value.items()}
    return [rounded(v, digits) for v in value] if isinstance(value, list | tuple) else value
