"""Ways in which an output may differ: of the reading as a whole, or with one driver.

offset        the output reads too much or too little
gain          it follows the healthy reading more or less than in proportion
timing        it comes late or early: a shift in time, to first order the slope
lag           it follows the healthy reading through a lag
level         a smooth function of a driver is added
dynamic       a driver's past is added: what a film, a volume or a slow wall leaves
timing with, gain with   the shift or the gain is a smooth function of a driver
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.response.drivers import Driver, rate
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import lag
from training.greybox.quantity.value import hats

LAGS_S: Final = (0.3, 1.0, 3.0)  # of the reading
PASTS_S: Final = (0.5, 1.5, 5.0, 20.0)  # of a driver
INTERVALS: Final = 12  # of a level's range: a ripple has many
INTERVALS_WITH: Final = 4  # of a shift's or a gain's

Make = Callable[[Comparison, FloatArray], FloatArray]  # run, driver (n,) → columns (n, k)


@dataclass(frozen=True, slots=True)
class Family:
    """One way to differ, and its columns in every run."""

    kind: str
    driver: Driver | None
    columns: tuple[FloatArray, ...]  # (n, k) of each run, new ones first
    knots: FloatArray | None = None  # of a level


def families_of(
    runs: Sequence[Comparison], drivers: Sequence[Driver], inputs: Sequence[str]
) -> list[Family]:
    """Return every family; the drivers' values are of the same runs.

    inputs : of the model; of these alone the past counts, and with them a shift or a gain may
        change, because any other signal may be an answer to the same cause
    """
    found = [
        Family(kind, None, tuple(make(r, np.zeros(len(r.residual))) for r in runs))
        for kind, make in UNIFORM.items()
    ]
    for driver in (d for d in drivers if d.name not in OF_READING):
        seen = np.concatenate([v[r.scored] for v, r in zip(driver.values, runs, strict=True)])
        for kind, make in _with(driver, seen, driver.name in inputs).items():
            columns = tuple(make(r, v) for r, v in zip(runs, driver.values, strict=True))
            found.append(Family(kind, driver, columns, _knots(seen) if kind == "level" else None))
    return found


def slope(run: Comparison) -> FloatArray:
    """Return minus the slope (n, 1) of the healthy reading, per second: a second of delay."""
    return -rate(run.phi_predicted, run.period_s)[:, np.newaxis]


def moved(run: Comparison) -> FloatArray:
    """Return the healthy reading (n, 1) about its mean."""
    read = run.phi_predicted
    return np.asarray((read - read[run.scored].mean())[:, np.newaxis])


def past(run: Comparison, values: FloatArray, lags_s: Sequence[float]) -> FloatArray:
    """Return lagged less present values (n, k), one column per lag."""
    return np.column_stack([lag(values, s, run.period_s) - values for s in lags_s])


UNIFORM: Final[dict[str, Make]] = {
    "offset": lambda r, _: np.ones((len(r.residual), 1)),
    "gain": lambda r, _: moved(r),
    "timing": lambda r, _: slope(r),
    "lag": lambda r, _: past(r, r.phi_predicted, LAGS_S),
    "response": lambda r, _: np.column_stack(
        [slope(r), moved(r), past(r, r.phi_predicted, LAGS_S)]
    ),
}
OF_READING: Final = ("phi_predicted", "phi_slope_1_s")  # the reading itself: asked above


def _with(driver: Driver, seen: FloatArray, is_input: bool) -> dict[str, Make]:
    knots, few = _knots(seen), _knots(seen, INTERVALS_WITH)
    spread = max(float(seen.std()), 1e-12)
    found: dict[str, Make] = {"level": lambda r, x: _centred(r, hats(x, knots))}
    if is_input:
        found |= {
            "dynamic": lambda r, x: past(r, x / spread, PASTS_S),
            "timing with": lambda r, x: hats(x, few) * slope(r),
            "gain with": lambda r, x: hats(x, few) * moved(r),
        }
    return found


def _knots(seen: FloatArray, intervals: int = INTERVALS) -> FloatArray:
    """Return quantiles of a variable's values (m,) between which a function is straight."""
    low, high = np.percentile(seen, [0.5, 99.5])
    inside, parts = seen[(seen >= low) & (seen <= high)], np.linspace(0.0, 1.0, intervals + 1)
    knots = np.unique(np.quantile(inside, parts))
    if len(knots) < 4:  # a variable that mostly rests has its quantiles at one value
        knots = np.unique(np.quantile(np.unique(inside), parts))
    return knots if len(knots) > 1 else np.array([seen.min(), seen.max()])


def _centred(run: Comparison, columns: FloatArray) -> FloatArray:
    """Return columns (n, k) about their mean: an offset is a family of its own."""
    return np.asarray(columns - columns[run.scored].mean(axis=0))
