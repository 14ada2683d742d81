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


def rounded(value: Any) -> Any:
    """Round floats to nine decimals; numbers that are not finite become null."""
    if isinstance(value, float):
        return round(value, 9) if math.isfinite(value) else None
    if isinstance(value, str | int) or value is None:
        return value
    if isinstance(value, Mapping):
        return {k: rounded(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(v) for v in value]
    return bool(value) if isinstance(value, np.bool_) else value
