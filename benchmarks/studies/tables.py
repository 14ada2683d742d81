"""Tables of a study: rows in groups, the confusion matrix, and cells for a page."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy import stats

from training.limits.rates import CONFIDENCE, Figures
from training.pages.heat import LEVELS, Heat, HeatCell
from training.pages.numbers import MISSING, NBSP, short, words

Row = Mapping[str, Any]
AND: Final = " + "  # between names
SEVERAL: Final = "several names"
TO: Final = "–\N{WORD JOINER}"  # between two bounds


def of_kind(rows: Iterable[Row], kind: str) -> list[Row]:
    """Return the rows of one kind of trials."""
    return [r for r in rows if r["kind"] == kind]


def split(rows: Iterable[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return the rows with the same values of the keys together, in order of first occurrence."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for r in rows:
        found.setdefault(tuple(r[key] for key in keys), []).append(r)
    return found


def grouped(
    rows: Iterable[Row], keys: Sequence[str], figures: Callable[[list[Row]], Figures]
) -> list[Figures]:
    """Return a row of figures for every group of rows with the same values of the keys."""
    return [
        dict(zip(keys, values, strict=True)) | figures(own)
        for values, own in split(rows, *keys).items()
    ]


def mean(values: Iterable[float]) -> float | None:
    """Return the mean, None without a value."""
    every = list(values)
    return sum(every) / len(every) if every else None


def median(times_s: Sequence[float | None]) -> Figures:
    """Return the median of times in s and its two-sided 95 % bounds; None means never.

    The bounds are order statistics and hold for any distribution.
    Source: Conover, Practical Nonparametric Statistics, 3rd ed., section 3.2.
    """
    x = np.sort([math.inf if t is None else t for t in times_s])
    n = len(x)
    figures: Figures = {"trials": n, "median": None, "low": None, "high": None}
    if n == 0:
        return figures
    below = int(stats.binom.ppf((1.0 - CONFIDENCE) / 2.0, n, 0.5))
    figures["median"] = _finite(float(x[(n - 1) // 2] + x[n // 2]) / 2.0)
    figures["low"] = _finite(float(x[below - 1])) if below else 0.0
    figures["high"] = _finite(float(x[n - below])) if below else None
    return figures


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def answers(pairs: Iterable[tuple[str, str]], order: Sequence[str] = ()) -> list[Figures]:
    """Return how often each condition that was driven got which answer.

    pairs : what was driven, and the names that were answered, joined by ``AND``
    order : of the names; others follow
    """
    return [
        {"driven": driven, "answered": answered, "trials": n}
        for (driven, answered), n in sorted(
            Counter(pairs).items(), key=lambda each: [_place(name, order) for name in each[0]]
        )
    ]


def _place(name: str, order: Sequence[str]) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order)), name


def confusion(rows: Sequence[Row], order: Sequence[str] = ()) -> Heat | None:
    """Return ``answers`` as a map, in percent of a row's trials; joined names as one column.

    Return None without a row.
    """
    if not rows:
        return None
    counts = Counter[tuple[str, str]]()
    for r in rows:
        counts[r["driven"], SEVERAL if AND in r["answered"] else r["answered"]] += r["trials"]
    driven, named = (
        sorted({pair[i] for pair in counts}, key=lambda name: _place(name, order)) for i in (0, 1)
    )
    found = []
    for a in driven:
        trials = sum(counts[a, b] for b in named)
        found.append((words(a), [_share(counts[a, b] / trials) for b in named]))
    return Heat("driven, by answer; %", [words(name) for name in named], found)


def _share(share: float) -> HeatCell:
    if share == 0.0:
        return HeatCell("")
    text = f"{100.0 * share:.0f}" if share >= 0.01 else "<1"
    return HeatCell(text, level=round(LEVELS * share))


def cells(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Return the head of a table and its cells; all rows have the keys of the first."""
    return [words(key) for key in rows[0]], [[cell(row[key]) for key in rows[0]] for row in rows]


def cell(value: Any) -> str:
    """Return a value of a table as text: rates in percent with bounds, medians in s.

    >>> cell(None), cell(0.123456), cell(["a_b", "c"]), cell(7)
    ('–', '0.123', 'a b, c', '7')
    """
    if isinstance(value, Mapping):
        return _figure(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(cell, value)) or MISSING
    if isinstance(value, float):
        return short(value, 3)
    return MISSING if value is None else words(str(value))


def _figure(value: Mapping[str, Any]) -> str:
    if "rate" in value:
        share, low, high = (100.0 * (value[k] or 0.0) for k in ("rate", "low", "high"))
        told = f"{share:.1f}{NBSP}({low:.0f}{TO}{high:.0f}) of {value['trials']}"
        return told if value["trials"] else MISSING
    if "median" in value:
        at, *bounds = (
            "never" if value[k] is None else f"{value[k]:.0f}" for k in ("median", "low", "high")
        )
        told = at if bounds == [at, at] else f"{at}{NBSP}({TO.join(bounds)})"
        return told if value["trials"] else MISSING
    if "per_1000_h" in value:
        return f"{short(value['per_1000_h'], 3)}, at most {short(value['high'], 3)}"
    return ", ".join(f"{words(k)} {cell(v)}" for k, v in value.items()) or MISSING
