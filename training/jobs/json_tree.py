"""Results as trees for JSON."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def json_tree(value: Any, digits: int | None = 5) -> Any:
    """Return a tree of JSON types; numbers that are not finite become None.

    digits : significant digits of a float, all of them if None

    >>> json_tree({"rmse": np.float64(0.123456), "n": np.int64(3), "worst": (np.inf,)})
    {'rmse': 0.12346, 'n': 3, 'worst': [None]}
    """
    if isinstance(value, Mapping):
        return {str(k): json_tree(v, digits) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_tree(value.tolist(), digits)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [json_tree(v, digits) for v in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    return value
