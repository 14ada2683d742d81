"""Answers of the naming to stored cases, and the figures that they give."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.outcome import Row
from training.limits.rates import rate

Answer = Mapping[str, Any]
Asked = Callable[[Answer], bool]
SUSPECTED: Final = "sensor_fault_suspected"
LIKE_SENSOR: Final = ("ethanol", "sensor_asymmetry")
NEAR: Final = 1.1  # times the error without the effect


def figures(answers: Sequence[Answer]) -> Iterator[Row]:
    """Yield a row for each engine and figure."""
    for engine in ("dyno", "second", "other"):
        own = [each for each in answers if engine in each["key"]]
        for words, (which, right) in COUNTS.items():
            asked = [each for each in own if which(each)]
            if asked:
                yield share(f"{engine}: {words}", sum(map(right, asked)), len(asked))
        closed = [each for each in map(_closed, own) if each is not None]
        taken = [each["cpu_s"] for each in own]
        for words, values, q in (
            ("share of the gap closed, twice", closed, 0.1),
            ("seconds of a case", taken, 0.95),
        ):
            if values:
                median, tail = np.quantile(values, (0.5, q))
                yield {"figure": f"{engine}: {words}", "median": median, f"{q:.0%}": tail}


def share(words: str, of: int, number: int) -> Row:
    """Return a share in percent with its exact 95 % bounds."""
    found = rate(of, number)
    names = {"%": "rate", "low": "low", "high": "high"}
    percent = {name: 100 * found[key] for name, key in names.items()}
    return {"figure": words, "n": of, "of": number} | percent


def ratio(row: Answer) -> float:
    """Return the gap over the noise."""
    return float(row["gap"] / row["noise"])


def _named(row: Answer) -> bool:
    return bool(row["verdict"] == "named")


def _right(row: Answer) -> bool:
    return _named(row) and _in_all(row)


def _in_set(row: Answer) -> bool:
    said = row["verdict"] in ("named", "ambiguous")
    return said and set(row["hidden"]) <= set(row["effects"])


def _reversed(row: Answer) -> bool:
    """Return whether one effect of the library is said to act in the other direction."""
    return _unknown(row) and any(":" not in effect for effect in row["effects"])


def _unknown(row: Answer) -> bool:
    return bool(row["verdict"] == "unknown_effect")


def _in_all(row: Answer) -> bool:
    return list(row["effects"]) == list(row["hidden"])


def _both(row: Answer) -> bool:
    return _named(row) and set(row["effects"]) == set(row["hidden"])


def _said(row: Answer) -> bool:
    """Return whether every effect is named, in the ambiguous set, or said to be beside it."""
    alike = {"ethanol"} if row["verdict"] == SUSPECTED else set()
    said = {*row["effects"], *row.get("beside", ())} | alike
    return set(row["hidden"]) <= said


def _formula(row: Answer) -> bool:
    return bool(row["after"]) and row["after"] <= NEAR * row["without"]


def _single(low: float, high: float = np.inf) -> Asked:
    return lambda row: row["kind"] == "effect" and low <= ratio(row) < high


def _kind(kind: str, least: float = 0.0) -> Asked:
    return lambda row: row["kind"] == kind and (ratio(row) >= least)


def _closed(row: Answer) -> float | None:
    excess = row["before"] ** 2 - row["without"] ** 2
    if not _single(2.0)(row) or excess <= 0.0:
        return None
    after = row["after"] or row["before"]
    return float(1.0 - (after**2 - row["without"] ** 2) / max(excess, 1e-12))


def _suspected(row: Answer) -> bool:
    return bool(row["verdict"] == SUSPECTED)


def _is(*verdicts: str) -> Asked:
    return lambda row: row["verdict"] in verdicts


ONE_TRUTH: Final = ("effect", "null", "unknown", "onset", "fault")
COUNTS: Final[Mapping[str, tuple[Asked, Asked]]] = {
    "names given that are right": (lambda r: _named(r) and r["kind"] in ONE_TRUTH, _right),
    "right name, twice the noise": (_single(2.0), _right),
    "in the set, twice the noise": (_single(2.0), _in_set),
    "suspected, twice the noise": (_single(2.0), _suspected),
    "right name, one to twice": (_single(1.0, 2.0), _right),
    "right name, below the noise": (_single(0.0, 1.0), _right),
    "nulls named": (_kind("null"), _named),
    "nulls unknown or suspected": (_kind("null"), _is("unknown_effect", SUSPECTED)),
    "faults suspected": (_kind("fault", 1.0), _suspected),
    "faults named": (_kind("fault"), _named),
    "onsets suspected": (_kind("onset", 1.0), _suspected),
    "onsets named": (_kind("onset"), _named),
    "outside, twice: unknown": (_kind("unknown", 2.0), _is("unknown_effect")),
    "outside, named": (_kind("unknown"), _named),
    "outside, called reversed": (_kind("unknown"), _reversed),
    "reversed, twice: said so": (_kind("reversed", 2.0), lambda r: _reversed(r) and _in_all(r)),
    "reversed: called another effect": (
        _kind("reversed"),
        lambda r: (_named(r) or _reversed(r)) and not _in_all(r),
    ),
    "two, twice: both right": (_kind("two", 2.0), _both),
    "two, twice: right or in a set": (_kind("two", 2.0), _said),
    "beside a fault: suspected": (_kind("beside"), _suspected),
    "beside a fault: and the effect said": (
        _kind("beside"),
        lambda r: _suspected(r) and _said(r),
    ),
    "unknown, twice: formula within 10 %": (_kind("unknown", 2.0), _formula),
    "two: a wrong name": (
        _kind("two"),
        lambda r: _named(r) and not set(r["effects"]) <= set(r["hidden"]),
    ),
}
