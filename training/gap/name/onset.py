"""Something that begins within the recordings: effects are always there, faults may not be."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.greybox.fit.case import Case
from training.greybox.fit.joint import JointFit

ONSET_T: Final = 6.0
ONSET_T_SORTED: Final = 9.0  # if drives were put in the order that suits an onset best
ONSET_BEFORE: Final = 0.25  # of the strength after, below which it was absent before
ONSET_BLOCKS: Final = 4  # at least, on either side
ONSET_KNOWN: Final = 0.02  # of all that is known of the strength, at least before it
ONSET_WEIGHT: Final = 1e-4  # of all that is known of the strength, below which a block says nothing


def onset_s(case: Case, before: JointFit, after: JointFit) -> tuple[str, float] | None:
    """Return the drive and time at which the gain of ``after`` began, None if always there.

    Every block says how strong the explanation is in it. An onset stays: in all drives, one
    after the other, the strength steps up once from nothing. The drives are looked at in the order
    given, and in the order of their own strengths, because files may not come as they were driven.
    """
    every = _strengths(case, before, after)
    by_strength = sorted(every, key=lambda each: each.mean)
    for order, least in ((every, ONSET_T), (by_strength, ONSET_T_SORTED)):
        place = _step(
            np.concatenate([each.strength for each in order]),
            np.concatenate([each.weight for each in order]),
            least,
        )
        if place is not None:
            times = [(each.name, t_s) for each in order for t_s in each.t_s]
            return times[place]
    return None


@dataclass(frozen=True, slots=True)
class _Strengths:
    """How strong an explanation is in the blocks of one drive that say anything."""

    name: str
    t_s: list[float]  # (n_blocks,) since the drive's beginning
    strength: FloatArray  # (n_blocks,)
    weight: FloatArray  # (n_blocks,) its inverse variance

    @property
    def mean(self) -> float:
        """Return the mean strength, 0 of no block."""
        return float((self.strength * self.weight).sum() / max(float(self.weight.sum()), 1e-12))


def _strengths(case: Case, before: JointFit, after: JointFit) -> list[_Strengths]:
    wanted, signature = -before.residual, after.residual - before.residual
    least = ONSET_WEIGHT * float((signature**2).sum())
    found, first = [], 0
    blocks = case.blocks
    for drive, kept in zip(case.drives, case.kept, strict=True):
        rows = slice(first, first + int(kept.sum()))
        first = rows.stop
        number, block = np.unique(blocks[rows], return_inverse=True)
        weight = _sums(block, signature[rows] ** 2)
        moved = _sums(block, wanted[rows] * signature[rows])
        begins = np.flatnonzero(kept)[np.searchsorted(block, np.arange(len(number)))]
        used = weight > least
        times = (begins[used] * drive.period_s).tolist()
        strength = moved[used] / weight[used]
        found.append(_Strengths(drive.name, times, strength, weight[used]))
    return found


def _sums(block: IntArray, values: FloatArray) -> FloatArray:
    return np.asarray(np.bincount(block, values), dtype=np.float64)


def _step(a: FloatArray, w: FloatArray, t_least: float) -> int | None:
    """Return the place at which strengths (n,) of inverse variances (n,) step up from nothing."""
    best: tuple[float, int] | None = None
    for k in range(ONSET_BLOCKS, len(a) - ONSET_BLOCKS + 1):
        low, high = np.average(a[:k], weights=w[:k]), np.average(a[k:], weights=w[k:])
        rest = np.concatenate([a[:k] - low, a[k:] - high])
        scatter = max(float((w * rest**2).sum()) / (len(a) - 2), 1.0)
        t = (high - low) / np.sqrt(scatter * (1.0 / w[:k].sum() + 1.0 / w[k:].sum()))
        absent = abs(low) < ONSET_BEFORE * high and w[:k].sum() > ONSET_KNOWN * w.sum()
        if absent and t > t_least and (best is None or t > best[0]):
            best = (float(t), k)
    return None if best is None else best[1]
