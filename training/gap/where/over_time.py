"""Whether the discrepancy starts within a recording, or drifts: a fault rather than physics.

Level and size of the residual in each block of time, their cumulative sum, and the same with the
blocks in random order. It is looked at again after what the best driver explains is taken away,
because a cold start or a motorway at the end of a drive is no onset.
Source: Pettitt, Applied Statistics 28 (1979); Page, Biometrika 41 (1954).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.gap.config import CONFIG
from training.greybox.fit.comparison import Comparison

LIMITS: Final = CONFIG.changes
ORDERS: Final = 9999  # random orders of the blocks

Quantity = Literal["level", "size"]
QUANTITIES: Final[tuple[Quantity, ...]] = get_args(Quantity)


@dataclass(frozen=True, slots=True)
class Change:
    """The clearest change of the residual within one recording."""

    recording: str
    quantity: Quantity  # mean residual, or its size
    kind: Literal["onset", "drift"]
    t_s: float  # of the change
    before: float  # mean residual, or root mean square, phi
    after: float
    p_value: float  # corrected for all recordings and both quantities
    p_beyond_regime: float  # the same after what the best driver explains is taken away
    beats_regime: bool  # a step at one time describes it better than the best driver does
    healthy: float  # the largest change within a healthy recording, phi; 0 without any
    block_s: FloatArray  # (b,) middle of each block
    blocks: FloatArray  # (b,) mean residual, or root mean square
    cumulative: FloatArray  # (b,)

    @property
    def significant(self) -> bool:
        """Return whether it is beyond chance, the best driver and changes on healthy drives."""
        beyond = abs(self.after - self.before) > self.healthy
        return (
            beyond
            and self.p_value < LIMITS.false_share
            and (self.beats_regime or self.p_beyond_regime < LIMITS.false_share)
        )

    @property
    def sentence(self) -> str:
        """Return the finding in words."""
        what = "mean residual" if self.quantity == "level" else "size of the residual"
        if self.kind == "drift":
            return (
                f"{self.recording}: the {what} drifts from {self.before:+.4f} to {self.after:+.4f} "
                "in phi over the drive."
            )
        return (
            f"{self.recording}: the {what} changes at {self.t_s:.0f} s from {self.before:+.4f} to "
            f"{self.after:+.4f} in phi."
        )


def find_changes(
    recordings: Sequence[Comparison],
    healthy: Sequence[Comparison],
    explained: Sequence[FloatArray] | None,
    rng: np.random.Generator,
) -> tuple[Change, ...]:
    """Return the changes of each recording that is long enough, the clearest first.

    explained : (n,) per recording, what the best driver explains of the residual
    """
    found = []
    for quantity in QUANTITIES:
        usual = [_shape(r, quantity) for r in healthy]
        largest = max((abs(u.after - u.before) for u in usual if u is not None), default=0.0)
        for i, r in enumerate(recordings):
            shape = _shape(r, quantity)
            if shape is None:
                continue
            rest = r.residual if explained is None else r.residual - explained[i]
            p, beyond = (_p_value(_blocks(r, x, quantity)[1], rng) for x in (r.residual, rest))
            found.append(
                replace(
                    shape,
                    p_value=p,
                    p_beyond_regime=beyond,
                    healthy=largest,
                    beats_regime=_step_beats(r, rest, shape.t_s, quantity),
                )
            )
    tests = len(found)
    corrected = [
        replace(
            c,
            p_value=min(c.p_value * tests, 1.0),
            p_beyond_regime=min(c.p_beyond_regime * tests, 1.0),
        )
        for c in found
    ]
    return tuple(sorted(corrected, key=lambda c: (not c.significant, c.p_value, c.p_beyond_regime)))


def _shape(r: Comparison, quantity: Quantity) -> Change | None:
    """Return the clearest change, not yet tested; None if the recording is too short."""
    block_s, values = _blocks(r, r.residual, quantity)
    if len(values) < LIMITS.blocks_min:
        return None
    cumulative = np.cumsum(values - values.mean())
    at = int(np.argmax(np.abs(cumulative[:-1])))
    step = _left(values, np.arange(len(values)) <= at)
    line = _left(values, block_s)
    shown = values if quantity == "level" else np.exp(values)
    first, last = slice(None, at + 1), slice(at + 1, None)
    return Change(
        recording=r.name,
        quantity=quantity,
        kind="onset" if step <= line else "drift",
        t_s=float((block_s[at] + block_s[at + 1]) / 2),
        before=float(shown[first].mean()),
        after=float(shown[last].mean()),
        p_value=1.0,
        p_beyond_regime=1.0,
        beats_regime=False,
        healthy=0.0,
        block_s=block_s,
        blocks=shown,
        cumulative=cumulative,
    )


def _step_beats(r: Comparison, rest: FloatArray, t_s: float, quantity: Quantity) -> bool:
    """Return whether a step at ``t_s`` leaves clearly less of the blocks than the driver does."""
    block_s, values = _blocks(r, r.residual, quantity)
    left = _blocks(r, rest, quantity)[1]
    driver = float(((left - left.mean()) ** 2).sum())
    return _left(values, block_s > t_s) < LIMITS.step_clearly * driver


def _blocks(
    r: Comparison, residual: FloatArray, quantity: Quantity
) -> tuple[FloatArray, FloatArray]:
    """Return the middle of each block and its mean, or the logarithm of its RMS about the mean."""
    length = max(round(LIMITS.block_s / r.period_s), 2)
    middles, values = [], []
    for start in range(0, len(residual) - length // 2, length):
        rows = np.flatnonzero(r.scored[start : start + length]) + start
        if len(rows) < length // 3:
            continue
        x = residual[rows]
        value = x.mean() if quantity == "level" else np.log(max(float(x.std()), 1e-9))
        middles.append((start + length / 2) * r.period_s)
        values.append(float(value))
    return np.array(middles), np.array(values)


def _left(values: FloatArray, column: FloatArray | BoolArray) -> float:
    """Return the squared error that a mean and one column leave."""
    design: FloatArray = np.column_stack([np.ones(len(values)), column]).astype(np.float64)
    fitted = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return float(((values - fitted) ** 2).sum())


def _p_value(values: FloatArray, rng: np.random.Generator) -> float:
    """Return how often blocks in random order have as large a cumulative sum."""
    centred = values - values.mean()
    largest = float(np.abs(np.cumsum(centred)).max())
    groups = len(centred) // LIMITS.blocks_together
    order = np.argsort(rng.random((ORDERS, groups)), axis=1)
    shuffled = (
        centred[: LIMITS.blocks_together * groups]
        .reshape(groups, LIMITS.blocks_together)[order]
        .reshape(ORDERS, -1)
    )
    chance = np.abs(np.cumsum(shuffled, axis=1)).max(axis=1)
    return (1.0 + float((chance >= largest * (1.0 - 1e-12)).sum())) / (1.0 + ORDERS)
