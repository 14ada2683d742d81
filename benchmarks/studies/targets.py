"""Targets of a study: the wanted and the measured figure, with 95 % bounds.

A target is met if the measured figure reaches the wanted one. It is proved if its bounds do, too.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

import numpy as np
from scipy import stats

from training.limits.rates import CONFIDENCE, Figures

Unit = Literal["share", "s", "drives"]
NEVER: Final = math.inf  # s, of a median time


@dataclass(frozen=True, slots=True)
class Target:
    """One measured figure and the range that it must lie in."""

    what: str
    where: str
    unit: Unit
    found: float | None  # None without a trial
    low: float | None = None  # 95 % bounds, None if there are none
    high: float | None = None
    trials: int = 0
    least: float | None = None  # wanted
    most: float | None = None
    why: str = ""  # reason why the figure cannot meet the target yet, though it can miss it

    @property
    def met(self) -> bool | None:
        """Whether the measured figure reaches the target; None if that cannot be said."""
        if self.found is None:
            return None
        reached = self._holds(self.found, self.found)
        return None if reached and self.why else reached

    @property
    def proved(self) -> bool | None:
        """Whether the bounds reach the target; None without the bounds it takes."""
        low = -math.inf if self.least is None else self.low
        high = math.inf if self.most is None else self.high
        return None if low is None or high is None else self._holds(low, high)

    def _holds(self, low: float, high: float) -> bool:
        return (self.least is None or low >= self.least) and (
            self.most is None or high <= self.most
        )

    @property
    def verdict(self) -> str:
        """Return the verdict in words: met, or missed and by how much."""
        if self.met is None or self.found is None:
            return f"not judged: {self.why or 'no such drive'}"
        if self.met:
            return "met, the bounds do not prove it" if self.proved is False else "met"
        if self.found == NEVER:
            return "missed: more than half are never found"
        wanted = self.least if self.most is None or self.found < self.most else self.most
        by = _number(abs(self.found - (wanted or 0.0)), self.unit)
        return f"missed by {by}".replace("%", "points")

    def as_row(self) -> dict[str, Any]:
        """Return the target as JSON values; a time of never is None."""
        row = asdict(self) | {"met": self.met, "proved": self.proved, "verdict": self.verdict}
        return {k: None if v == NEVER else v for k, v in row.items()}

    def cells(self) -> tuple[str, ...]:
        """Return what and where, wanted, found, bounds, trials and verdict as texts."""
        wanted = [("≥", self.least), ("≤", self.most)]
        bounds = ["-" if x is None else _number(x, self.unit) for x in (self.low, self.high)]
        return (
            f"{self.where}: {self.what}" if self.where else self.what,
            " and ".join(f"{sign} {_number(x, self.unit)}" for sign, x in wanted if x is not None),
            "-" if self.found is None else _number(self.found, self.unit),
            " to ".join(bounds),
            str(self.trials),
            self.verdict,
        )


def share(
    what: str, where: str, found: Figures, least: float | None = None, most: float | None = None
) -> Target:
    """Return the target of a rate; ``least`` and ``most`` are shares.

    >>> share("named", "", {"rate": 0.5, "low": 0.2, "high": 0.8, "trials": 9}, 0.9).verdict
    'missed by 40.0 points'
    """
    low, high, n = found["low"], found["high"], found["trials"]
    return Target(what, where, "share", found["rate"], low, high, n, least, most)


def time(what: str, where: str, found: Figures, most: float) -> Target:
    """Return the target of a median time in s, as ``rates.median`` gives it."""
    median, low, high = (
        NEVER if found["trials"] and found[k] is None else found[k]
        for k in ("median", "low", "high")
    )
    return Target(what, where, "s", median, low, high, found["trials"], most=most)


def quantile(
    what: str,
    where: str,
    values: Sequence[float],
    at: float,
    unit: Unit = "share",
    least: float | None = None,
    most: float | None = None,
) -> Target:
    """Return the target of a quantile of values; its bounds are order statistics.

    Source: Conover, Practical Nonparametric Statistics, 3rd ed., section 3.2.
    """
    if not values:
        return Target(what, where, unit, None, least=least, most=most)
    test: Any = stats.quantile_test(values, p=at)
    low, high = (None if np.isnan(x) else float(x) for x in test.confidence_interval(CONFIDENCE))
    found, n = float(np.quantile(values, at)), len(values)
    return Target(what, where, unit, found, low, high, n, least, most)


def _number(value: float, unit: Unit) -> str:
    if value == NEVER:
        return "never"
    if unit == "share":
        return f"{100.0 * value:.1f} %"
    return f"{value:.1f} s" if unit == "s" else f"{value:.3g}"
