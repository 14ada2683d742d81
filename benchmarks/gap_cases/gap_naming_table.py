"""The table of answers of ``gap_naming``: one column per file of answers."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import beta

from training.greybox.fit.sensor_faults import FAULTS

Row = Mapping[str, Any]
SUSPECTED: Final = "sensor_fault_suspected"
CONFIDENCE: Final = 0.95
SENSOR: Final = (*(fault.name for fault in FAULTS), "onset", "base_moved")
LIKE_SENSOR: Final = ("ethanol", "sensor_asymmetry")
NEAR: Final = 1.1  # times the error without the effect
BINS: Final = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)


def table(paths: Sequence[Path]) -> str:
    """Return figures of the cases that all files answer."""
    files = [{r["key"]: r for r in map(json.loads, p.read_text().splitlines())} for p in paths]
    shared = set.intersection(*(set(each) for each in files))
    lines = [f"{len(shared)} cases: " + ", ".join(path.stem for path in paths)]
    for engine in ("dyno", "second", "other"):
        sets = [[r for k, r in each.items() if k in shared and engine in k] for each in files]
        if sets[0]:
            lines.append(f"-- {engine}")
            lines += [_line(words, [of(rows) for rows in sets]) for words, of in FIGURES.items()]
    lines += [calibration(list(each.values())) for each in files if any_posterior(each)]
    return "\n".join(lines)


def share(of: int, number: int) -> str:
    """Return a share in percent with its exact bounds (Clopper and Pearson, 1934)."""
    if not number:
        return "none"
    tail = (1.0 - CONFIDENCE) / 2.0
    low = beta.ppf(tail, of, number - of + 1) if of else 0.0
    high = beta.ppf(1.0 - tail, of + 1, number - of) if of < number else 1.0
    return f"{of}/{number} {100 * of / number:.1f} % ({100 * low:.1f}-{100 * high:.1f})"


def _line(words: str, values: Sequence[str]) -> str:
    return f"{words:<38}" + "".join(f"{value:<30}" for value in values)


def _count(which: Callable[[Row], bool], right: Callable[[Row], bool]) -> Callable[[Any], str]:
    def of(rows: Sequence[Row]) -> str:
        asked = [row for row in rows if which(row)]
        return share(sum(right(row) for row in asked), len(asked))

    return of


def ratio(row: Row) -> float:
    """Return the gap over the noise."""
    return float(row["gap"] / row["noise"])


def _named(row: Row) -> bool:
    return bool(row["verdict"] == "named")


def _right(row: Row) -> bool:
    return _named(row) and list(row["effects"]) == list(row["hidden"])


def _in_set(row: Row) -> bool:
    said = row["verdict"] in ("named", "ambiguous")
    return said and set(row["hidden"]) <= set(row["effects"])


def _both(row: Row) -> bool:
    return _named(row) and set(row["effects"]) == set(row["hidden"])


def _said(row: Row) -> bool:
    """Return whether every effect is named, in the ambiguous set, or said to be beside it."""
    alike = {"ethanol"} if row["verdict"] == SUSPECTED else set()
    said = {*row["effects"], *row.get("beside", ())} | alike
    return set(row["hidden"]) <= said


def _formula(row: Row) -> bool:
    return bool(row["after"]) and row["after"] <= NEAR * row["without"]


def _single(low: float, high: float = np.inf) -> Callable[[Row], bool]:
    return lambda row: row["kind"] == "effect" and low <= ratio(row) < high


def _kind(kind: str, least: float = 0.0) -> Callable[[Row], bool]:
    return lambda row: row["kind"] == kind and (ratio(row) >= least)


def _closed(rows: Sequence[Row]) -> str:
    shares = [
        1.0 - ((r["after"] or r["before"]) ** 2 - r["without"] ** 2) / max(excess, 1e-12)
        for r in rows
        if _single(2.0)(r) and (excess := r["before"] ** 2 - r["without"] ** 2) > 0.0
    ]
    if not shares:
        return "none"
    return f"{100 * np.median(shares):.0f} %, {100 * np.quantile(shares, 0.1):.0f} %"


def _seconds(rows: Sequence[Row]) -> str:
    taken = [row["cpu_s"] for row in rows]
    return f"{np.median(taken):.1f}, {np.quantile(taken, 0.95):.1f}"


FIGURES: Final[Mapping[str, Callable[[Any], str]]] = {
    "names given that are right": _count(
        lambda r: _named(r) and r["kind"] in ("effect", "null", "unknown", "onset", "fault"), _right
    ),
    "right name, twice the noise": _count(_single(2.0), _right),
    "in the set, twice the noise": _count(_single(2.0), _in_set),
    "suspected, twice the noise": _count(_single(2.0), lambda r: r["verdict"] == SUSPECTED),
    "right name, one to twice": _count(_single(1.0, 2.0), _right),
    "right name, below the noise": _count(_single(0.0, 1.0), _right),
    "nulls named": _count(_kind("null"), _named),
    "nulls unknown or suspected": _count(
        _kind("null"), lambda r: r["verdict"] in ("unknown_effect", SUSPECTED)
    ),
    "faults suspected": _count(_kind("fault", 1.0), lambda r: r["verdict"] == SUSPECTED),
    "faults named": _count(_kind("fault"), _named),
    "onsets suspected": _count(_kind("onset", 1.0), lambda r: r["verdict"] == SUSPECTED),
    "onsets named": _count(_kind("onset"), _named),
    "outside, twice: unknown": _count(
        _kind("unknown", 2.0), lambda r: r["verdict"] == "unknown_effect"
    ),
    "outside, named": _count(_kind("unknown"), _named),
    "two, twice: both right": _count(_kind("two", 2.0), _both),
    "two, twice: right or in a set": _count(_kind("two", 2.0), _said),
    "beside a fault: suspected": _count(_kind("beside"), lambda r: r["verdict"] == SUSPECTED),
    "beside a fault: and the effect said": _count(
        _kind("beside"), lambda r: r["verdict"] == SUSPECTED and _said(r)
    ),
    "unknown, twice: formula within 10 %": _count(_kind("unknown", 2.0), _formula),
    "two: a wrong name": _count(
        _kind("two"), lambda r: _named(r) and not set(r["effects"]) <= set(r["hidden"])
    ),
    "closed, twice: median, tenth": _closed,
    "CPU s per case: median, 95 %": _seconds,
}


def any_posterior(answers: Mapping[str, Row]) -> bool:
    """Return whether the answers carry probabilities."""
    return any(row["posterior"] for row in answers.values())


def truth(row: Row) -> set[str]:
    """Return the hypotheses of the posterior that are right in a case.

    What moves the error by less than the noise may be taken for nothing. Another fuel is of the
    gain class, and so is a biased sensor; a slow direction is one of the sensor.
    """
    small = {"none"} if ratio(row) < 1.0 else set()
    if row["kind"] in ("fault", "onset"):
        return {"sensor", *LIKE_SENSOR} | small
    if row["kind"] == "unknown":
        return {"unknown"} | small
    if row["kind"] == "null":
        return {"none"}
    return (
        {*row["hidden"]} | ({"sensor"} if set(row["hidden"]) & set(LIKE_SENSOR) else set()) | small
    )


def grouped(probabilities: Mapping[str, float]) -> dict[str, float]:
    """Return the posterior with all hypotheses of the sensor as one."""
    found = {name: p for name, p in probabilities.items() if name not in SENSOR}
    return found | {"sensor": sum(p for name, p in probabilities.items() if name in SENSOR)}


def calibration(rows: Sequence[Row]) -> str:
    """Return the reliability diagram of the likeliest hypothesis as text, and its error.

    Source: Naeini, Cooper, Hauskrecht, Obtaining well calibrated probabilities, AAAI 2015.
    """
    said = []
    for row in rows:
        if not row["posterior"] or row["kind"] in ("two", "beside"):
            continue
        every = grouped(row["posterior"])
        best = max(every, key=lambda name: every[name])
        said.append((every[best], best in truth(row)))
    p, right = np.array([a for a, _ in said]), np.array([b for _, b in said])
    place = np.clip(np.digitize(p, BINS) - 1, 0, len(BINS) - 2)
    lines, error = ["probability said: right"], 0.0
    for i in range(len(BINS) - 1):
        own = place == i
        if own.any():
            error += own.mean() * abs(p[own].mean() - right[own].mean())
            right_of = share(int(right[own].sum()), int(own.sum()))
            lines.append(
                f"{BINS[i]:.2f} to {BINS[i + 1]:.2f}, mean {p[own].mean():.3f}: {right_of}"
            )
    return "\n".join([*lines, f"expected calibration error {error:.3f} of {len(said)}"])
