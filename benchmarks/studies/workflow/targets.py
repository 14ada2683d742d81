"""Targets of the gap study: the wanted and the measured figure, with 95 % bounds.

A target is met if the measured figure reaches the wanted one. It is proved if the worse of the two
95 % bounds reaches it, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from benchmarks.studies.workflow.answers import (
    CLASSES,
    SUSPECTED,
    closed,
    done,
    errs,
    large,
    right,
    right_or_among,
    right_or_beside_fault,
    size,
    wrong_names,
)
from benchmarks.studies.workflow.case import Row
from training.limits.rates import rate
from training.limits.tolerance import quantile_bounds

SECONDS_MOST: Final = {"greybox": 15.0, "narx": 60.0}
SLOW: Final = 0.95  # quantile of the seconds per case that the target limits


@dataclass(frozen=True, slots=True)
class Target:
    """One measured figure and the value that it must reach."""

    what: str
    where: str
    unit: Literal["share", "s"]
    at_least: bool  # True: ``wanted`` is a lower bound; False: an upper bound
    wanted: float
    found: float | None  # measured figure; None without a case
    low: float | None
    high: float | None
    cases: int

    @property
    def met(self) -> bool | None:
        """Whether the measured figure reaches the target; None without a case."""
        return self._holds(self.found)

    @property
    def proved(self) -> bool | None:
        """Whether the worse 95 % bound reaches the target; None without such a bound."""
        return self._holds(self.low if self.at_least else self.high)

    @property
    def verdict(self) -> str:
        """Return the verdict in words: met, or missed and by how much."""
        if self.met is None or self.found is None:
            return "no such case"
        if self.met:
            return "met" if self.proved else "met, the bound does not prove it"
        by = abs(self.found - self.wanted)
        return "missed by " + (
            f"{100.0 * by:.1f} points" if self.unit == "share" else f"{by:.1f} s"
        )

    def _holds(self, value: float | None) -> bool | None:
        if value is None:
            return None
        return value >= self.wanted if self.at_least else value <= self.wanted


def assess(rows: Sequence[Row], base: str) -> list[Target]:
    """Return the targets in the order of the report; rows with an error are left out.

    base : kind of the base model, ``greybox`` or ``narx``
    """
    effect = done(rows, "effect")
    big = large(effect)
    small = [r for r in effect if size(r) == CLASSES[1]]
    null, unknown = done(rows, "null"), large(done(rows, "unknown"))
    onset, fault = done(rows, "onset"), done(rows, "fault")
    named = [r for r in big if right(r)]
    wide, narrow = "one effect, gap at least twice the noise", "one effect, gap 1 to 2 times"
    return [
        _names(rows),
        _share("right name", wide, 0.90, [right(r) for r in big]),
        _share("right or in the ambiguous set", wide, 0.95, [right_or_among(r) for r in big]),
        _share(
            "the same, or what the suspected fault is said to look like",
            wide,
            0.95,
            [right_or_beside_fault(r) for r in big],
        ),
        _share("right name", narrow, 0.85, [right(r) for r in small]),
        _share(
            "an effect named",
            "nothing hidden",
            0.01,
            [bool(r["names"]) for r in null],
            at_least=False,
        ),
        _share(
            "unknown_effect",
            "outside the library, gap at least twice",
            0.90,
            [r["verdict"] == "unknown_effect" for r in unknown],
        ),
        _share(
            "a wrong name",
            "outside the library, gap at least twice",
            0.05,
            [bool(r["names"]) for r in unknown],
            at_least=False,
        ),
        _share(
            "taken for an effect",
            "sensor fault with an onset",
            0.01,
            [bool(r["names"]) for r in onset],
            at_least=False,
        ),
        _share(
            "suspected",
            "sensor fault from the start",
            0.95,
            [r["verdict"] == SUSPECTED for r in fault],
        ),
        _share(
            "added to the model",
            "sensor fault from the start",
            0.0,
            [bool(r["added"]) for r in fault],
            at_least=False,
        ),
        *_closing(named, "rightly named, gap at least twice"),
        *_closing(big, f"all of {wide}"),
        *_closing([r for r in effect if errs(r)], "one effect, excess at least twice the noise"),
        *_detection(named),
        _quantile(
            "seconds per case, 95 % of them",
            "all",
            SECONDS_MOST[base],
            [r["seconds"] for r in done(rows)],
            SLOW,
            unit="s",
        ),
    ]


def _names(rows: Sequence[Row]) -> Target:
    """Return the target for the share of right names among all names in all cases."""
    given = [(r, name) for r in done(rows) for name in r["names"]]
    good = [name not in wrong_names(r) for r, name in given]
    return _share("right of all names given", "everything hidden", 0.98, good)


def _share(
    what: str, where: str, wanted: float, good: Sequence[bool], *, at_least: bool = True
) -> Target:
    return _rate(what, where, wanted, sum(good), len(good), at_least=at_least)


def _rate(
    what: str, where: str, wanted: float, events: int, trials: int, *, at_least: bool = True
) -> Target:
    found = rate(events, trials)
    return Target(
        what=what,
        where=where,
        unit="share",
        at_least=at_least,
        wanted=wanted,
        found=found["rate"],
        low=found["low"],
        high=found["high"],
        cases=trials,
    )


def _closing(rows: Sequence[Row], where: str) -> list[Target]:
    shares = [share for r in rows if (share := closed(r)) is not None]
    return [
        _quantile("gap closed, median", where, 0.90, shares, 0.5),
        _quantile("gap closed, tenth percentile", where, 0.60, shares, 0.1),
    ]


def _detection(rows: Sequence[Row]) -> list[Target]:
    """Return targets for detection: the new models must find as many faults as the old ones.

    The verification puts faults on drives. An old model that takes the gap for a fault reports a
    fault on every drive. Two further comparisons allow for this: right fault names, and the old
    model with limits set on the same drives as the new model's.
    """
    found = []
    of_old = "new models, rightly named; wanted is what the old ones do"
    for what, key, after, before, at_least, where in (
        ("faults put on and found", "faults", "after", "before", True, of_old),
        (
            "faults put on and found",
            "faults",
            "after",
            "alike",
            True,
            f"{of_old} with limits set alike",
        ),
        ("faults put on and named right", "faults", "after_named", "before_named", True, of_old),
        ("false alarms", "alarms", "after", "before", False, of_old),
    ):
        counts = [r[key] for r in rows if r[key] and {after, before} <= set(r[key])]
        drives, new, old = (sum(c[part] for c in counts) for part in ("drives", after, before))
        wanted = old / drives if drives else 0.0
        found.append(_rate(what, where, wanted, new, drives, at_least=at_least))
    return found


def _quantile(
    what: str,
    where: str,
    wanted: float,
    values: Sequence[float],
    share: float,
    unit: Literal["share", "s"] = "share",
) -> Target:
    low, high = quantile_bounds(values, share) if values else (None, None)
    return Target(
        what=what,
        where=where,
        unit=unit,
        at_least=unit == "share",
        wanted=wanted,
        found=float(np.quantile(values, share)) if values else None,
        low=low,
        high=high,
        cases=len(values),
    )
