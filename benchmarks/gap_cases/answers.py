"""Answers of the naming to stored cases, and the figures that they give."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.outcome import Row
from training.gap.name.posterior import likely
from training.greybox.fit.sensor_faults import FAULTS
from training.limits.rates import rate

Answer = Mapping[str, Any]
Asked = Callable[[Answer], bool]
SUSPECTED: Final = "sensor_fault_suspected"
LIKE_FAULT: Final = ("onset", "ethanol")
LIKE_SENSOR: Final = ("ethanol", "sensor_asymmetry")
TRUTH: Final = {"null": "none", "unknown": "unknown", "reversed": "{} reversed"}  # else the names
NEAR: Final = 1.1  # times the error without the effect


def figures(answers: Sequence[Answer]) -> Iterator[Row]:
    """Yield calibration errors, and a row for each engine and figure."""
    for words, kinds in {"": ("effect", *TRUTH), ", two": ("two",)}.items():
        asked = [each for each in answers if each["kind"] in kinds]
        yield {"figure": f"calibration error{words}", "value": calibration_error(asked)}
    for engine in ("dyno", "second", "other"):
        own = [each for each in answers if engine in each["key"]]
        for words, (which, right) in COUNTS.items():
            asked = [each for each in own if which(each)]
            if asked:
                yield share(f"{engine}: {words}", sum(map(right, asked)), len(asked))
        if taken := [each["cpu_s"] for each in own]:
            median, most = np.quantile(taken, (0.5, 0.95))
            yield {"figure": f"{engine}: seconds of a case", "median": median, "95%": most}


def share(words: str, of: int, number: int) -> Row:
    """Return a share in percent with its exact 95 % bounds."""
    found = rate(of, number)
    names = {"%": "rate", "low": "low", "high": "high"}
    percent = {name: 100 * found[key] for name, key in names.items()}
    return {"figure": words, "n": of, "of": number} | percent


def ratio(row: Answer) -> float:
    """Return the gap over the noise."""
    return float(row["gap"] / row["noise"])


def _is(*verdicts: str) -> Asked:
    return lambda row: row["verdict"] in verdicts


_named, _unknown, _suspected = _is("named"), _is("unknown_effect"), _is(SUSPECTED)


def _right(row: Answer) -> bool:
    return _named(row) and _in_all(row)


def _in_set(row: Answer) -> bool:
    said = row["verdict"] in ("named", "ambiguous")
    return said and set(row["hidden"]) <= set(row["effects"])


def _reversed(row: Answer) -> bool:
    """Return whether one effect of the library is said to act in the other direction."""
    return _unknown(row) and any(":" not in effect for effect in row["effects"])


def _in_all(row: Answer) -> bool:
    return list(row["effects"]) == list(row["hidden"])


def _both(row: Answer) -> bool:
    return _named(row) and set(row["effects"]) == set(row["hidden"])


def _said(row: Answer) -> bool:
    """Return whether every effect is named, in the ambiguous set, or said to be beside it."""
    alike = {"ethanol"} if row["verdict"] == SUSPECTED else set()
    said = {*row["effects"], *row.get("beside", ())} | alike
    return set(row["hidden"]) <= said


def contradicts(row: Answer) -> bool:
    """Return whether the verdict is none of the likeliest hypotheses, as few as hold 95 %."""
    verdict = row["verdict"]
    several = verdict in (SUSPECTED, "ambiguous")
    hypotheses = likely(row["posterior"])[: None if several else 1]
    said = {part for name in hypotheses for part in name.split("+")}
    named = {label for label in row["labels"] if not label.startswith("empirical")}
    by_verdict = {"no_gap": {"none"}, SUSPECTED: {*LIKE_FAULT, *(fault.name for fault in FAULTS)}}
    return not said & by_verdict.get(verdict, named or {"unknown"})


def calibration_error(rows: Sequence[Answer]) -> float:
    """Return the expected calibration error of the likeliest hypothesis, in ten bins.

    Source: Guo et al., On calibration of modern neural networks, ICML 2017.
    """
    asked = [(*next(iter(r["posterior"].items())), r) for r in rows]
    sure = np.array([p for _, p, _ in asked])
    truth = [TRUTH.get(r["kind"], "+".join(r["hidden"])).format(*r["hidden"]) for _, _, r in asked]
    right = [{*a.split("+")} == {*b.split("+")} for (a, *_), b in zip(asked, truth, strict=True)]
    bins = np.bincount(np.minimum((10.0 * sure).astype(int), 9), sure - right)
    return float(np.abs(bins).sum() / max(len(sure), 1))


def _single(low: float, high: float = np.inf) -> Asked:
    return lambda row: row["kind"] == "effect" and low <= ratio(row) < high


def _kind(kind: str, least: float = 0.0) -> Asked:
    return lambda row: row["kind"] == kind and (ratio(row) >= least)


ONE_TRUTH: Final = ("effect", "null", "unknown", "onset", "fault")
COUNTS: Final[Mapping[str, tuple[Asked, Asked]]] = {
    "verdict against its probabilities": (lambda _: True, contradicts),
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
    "beside a fault: and the effect said": (_kind("beside"), lambda r: _suspected(r) and _said(r)),
    "two: a wrong name": (
        _kind("two"),
        lambda r: _named(r) and not set(r["effects"]) <= set(r["hidden"]),
    ),
}
