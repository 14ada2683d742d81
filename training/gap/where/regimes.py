"""Which variable explains the excess, and where on the way to the sensor it acts.

Each candidate of ``candidates`` is fitted to blocks of time and scored by the squared error that it
takes away in others, beyond what it explains on healthy recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.gap.where.bootstrap import Excess, Share, p_of_gains
from training.gap.where.candidates import (
    EVERYWHERE,
    Candidate,
    Curve,
    Point,
    Side,
    curve_of,
    evaluate,
)
from training.gap.where.splines import Basis, held_out, normal
from training.greybox.fit.comparison import FOLDS, gather
from training.pages.numbers import percent

LIMITS: Final = CONFIG.regimes
CURVES: Final = 4  # of the best regimes are drawn


@dataclass(frozen=True, slots=True)
class Regime:
    """The share of the excess that one driver explains at one point."""

    driver: str
    words: str
    unit: str
    point: Point
    share: Share  # of the excess squared error, on held-out blocks
    p_value: float  # corrected for all candidates
    wins: float  # share of the draws in which it explains clearly more than the next
    gains: FloatArray  # (n_blocks,) squared error taken away in each held-out block, beyond what
    # healthy and new blocks have in common: what the ranking goes by
    curve: Curve | None

    @property
    def significant(self) -> bool:
        """Return whether the dependence is beyond chance and worth a sentence."""
        return self.p_value < LIMITS.false_share and self.share.value >= LIMITS.excess_min

    @property
    def separated(self) -> bool:
        """Return whether the next in the ranking is clearly worse."""
        return self.wins >= LIMITS.wins_min

    @property
    def sentence(self) -> str:
        """Return the finding in words."""
        if self.driver == EVERYWHERE:
            return f"{self.share} of the excess is {_UNIFORM[self.point]}."
        return f"{self.share} of the excess {_FOLLOWS[self.point]} {self.words}{_shape(self)}."


_UNIFORM: Final = {
    "before the transport": "a constant offset of the mixture",
    "at the sensor": "a constant offset",
    "timing": "edges that come too early or too late, the same everywhere",
    "sensitivity": "a sensitivity that is off, the same everywhere",
}
_FOLLOWS: Final = {
    "before the transport": "follows, before the transport to the sensor, the",
    "at the sensor": "follows, at the sensor and not before it, the",
    "timing": "is edges that come too early or too late, depending on the",
    "sensitivity": "is a sensitivity that depends on the",
}


def _shape(regime: Regime) -> str:
    curve = regime.curve
    if curve is None:
        return ""
    top = int(np.argmax(np.abs(curve.y - curve.typical)))
    at = f"{curve.x[top]:.3g} {regime.unit}".strip()
    value = float(curve.y[top])
    if regime.point == "timing":
        return f": {abs(value) * 1e3:.0f} ms {'late' if value < 0 else 'early'} at {at}"
    if regime.point == "sensitivity":
        return f": {percent(value, 1, '+')} at {at}"
    side = "richer" if value > 0 else "leaner"
    return f": at {at} the sensor reads {abs(value):.4f} {side} in phi than predicted"


def find_regimes(
    new: Side, healthy: Side | None, excess: Excess, rng: np.random.Generator
) -> tuple[Regime, tuple[Regime, ...]]:
    """Return the constant offset, and every driver and point that was tried beside it.

    What is beyond chance and explains most comes first; a uniform change at a point goes before
    drivers that are not clearly better at that point.
    """
    left_out = set(between_recordings(new))
    names = [
        n for n in new.drivers if n not in left_out and (healthy is None or n in healthy.drivers)
    ]
    tried = [c for n in (EVERYWHERE, *names) for c in evaluate(new, healthy, n)]
    p_values = dict(
        zip(map(id, tried), p_of_gains(np.array([c.tested for c in tried]), rng), strict=True)
    )
    constant, *others = tried
    others.sort(key=lambda c: (p_values[id(c)] >= LIMITS.false_share, -float(c.tested.sum())))
    ranked = _simplest_first(others, excess)
    nothing = np.zeros_like(constant.tested)
    followers = [c.tested if p_values[id(c)] < LIMITS.false_share else nothing for c in ranked[1:]]
    regimes = tuple(
        _regime(c, float(p_values[id(c)]), follower, excess, rank < CURVES)
        for rank, (c, follower) in enumerate(zip(ranked, [*followers, nothing], strict=True))
    )
    return _regime(constant, float(p_values[id(constant)]), nothing, excess, False), regimes


def between_recordings(side: Side) -> tuple[str, ...]:
    """Return the drivers that mostly tell one recording from another, where there are few.

    Whatever else differs between a handful of drives would be put down to them.
    """
    n = len(side.recordings)
    if not 1 < n < LIMITS.recordings_many:
        return ()
    least = LIMITS.within_min if n < FOLDS else LIMITS.within_min_constant
    found = []
    for name, driver in side.drivers.items():
        each = [v[rows] for v, rows in zip(driver.values, side.blocks.rows, strict=True)]
        total = float(np.var(np.concatenate(each)))
        within = sum(len(v) * float(np.var(v)) for v in each) / sum(len(v) for v in each)
        if within < least * total:
            found.append(name)
    return tuple(found)


def _regime(
    c: Candidate, p_value: float, follower: FloatArray, excess: Excess, drawn: bool
) -> Regime:
    return Regime(
        driver=c.name,
        words=c.name if c.driver is None else c.driver.words,
        unit="" if c.driver is None else c.driver.unit,
        point=c.point,
        share=excess.share(c.gains),
        p_value=p_value,
        wins=_wins(c.tested, follower, excess),
        gains=c.tested,
        curve=curve_of(c, excess) if drawn and c.driver is not None else None,
    )


def rivals(regimes: Sequence[Regime], excess: Excess) -> tuple[Regime, ...]:
    """Return those behind the first that the recordings do not tell from it."""
    return tuple(
        r
        for r in regimes[1:]
        if r.significant and _wins(regimes[0].gains, r.gains, excess) < LIMITS.wins_min
    )


def explained_by(regime: Regime, new: Side) -> list[FloatArray]:
    """Return the part of the residual that a regime explains, (n,) per recording.

    From blocks that did not fit it; 0 where not scored.
    """
    driver = new.drivers.get(regime.driver)
    basis = None if driver is None else Basis.of(gather(driver.values, new.blocks))
    design = new.design(new.functions(regime.driver, basis), regime.point)
    found = held_out(normal(design, new.blocks), new.blocks.fold)
    fitted = (design * found[new.blocks.block]).sum(axis=1)
    result, start = [], 0
    for r, rows in zip(new.recordings, new.blocks.rows, strict=True):
        each = np.zeros(len(r.residual))
        each[rows] = fitted[start : start + len(rows)]
        result.append(each)
        start += len(rows)
    return result


def _wins(better: FloatArray, worse: FloatArray, excess: Excess) -> float:
    """Return the share of draws in which the better one gains clearly more, not just nearly."""
    return float(np.mean(excess.counts @ ((1.0 - LIMITS.near) * better - worse) > 0.0))


def _simplest_first(tried: list[Candidate], excess: Excess) -> list[Candidate]:
    """Return the ranking with uniform changes before drivers that do not clearly beat them."""
    ranked = list(tried)
    for uniform in [c for c in tried if c.driver is None]:
        at = ranked.index(uniform)
        beaten = next(
            (
                i
                for i, c in enumerate(ranked[:at])
                if c.driver is not None
                and c.point == uniform.point
                and _wins(c.tested, uniform.tested, excess) < LIMITS.wins_min
            ),
            at,
        )
        ranked.insert(beaten, ranked.pop(at))
    return ranked
