"""Something that begins within the recordings: effects are always there, faults may not be."""

from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.fit.case import Case
from training.greybox.fit.joint import JointFit

ONSET_T: Final = 6.0
ONSET_BEFORE: Final = 0.25  # of the strength after, below which it was absent before
ONSET_BLOCKS: Final = 4  # at least, on either side
ONSET_KNOWN: Final = 0.02  # of all that is known of the strength, at least before it
ONSET_WEIGHT: Final = 1e-4  # of all that is known of the strength, below which a block says nothing


def onset_s(case: Case, before: JointFit, after: JointFit) -> tuple[str, float] | None:
    """Return the drive and time at which the gain of ``after`` began, None if always there.

    Every block says how strong the explanation is in it. An onset stays: in all drives, one
    after the other in the order given, the strength steps up once from nothing.
    """
    wanted, signature, blocks = -before.residual, after.residual - before.residual, case.blocks
    _, first, block = np.unique(blocks, return_index=True, return_inverse=True)
    weight = np.bincount(block, signature**2).astype(np.float64)
    strength = np.bincount(block, wanted * signature) / np.maximum(weight, 1e-300)
    used = np.flatnonzero(weight > ONSET_WEIGHT * weight.sum())
    place = _step(strength[used], weight[used])
    if place is None:
        return None
    ends = np.cumsum([len(rows) for rows in case.rows])
    at = int(first[used[place]])
    i = int(np.searchsorted(ends, at, side="right"))
    row = case.rows[i][at - ends[i]]  # counted from the drive's end
    return case.drives[i].name, float(row * case.drives[i].period_s)


def _step(a: FloatArray, w: FloatArray) -> int | None:
    """Return the place at which strengths (n,) of inverse variances (n,) step up from nothing."""
    best: tuple[float, int] | None = None
    for k in range(ONSET_BLOCKS, len(a) - ONSET_BLOCKS + 1):
        low, high = np.average(a[:k], weights=w[:k]), np.average(a[k:], weights=w[k:])
        rest = np.concatenate([a[:k] - low, a[k:] - high])
        scatter = max(float((w * rest**2).sum()) / (len(a) - 2), 1.0)
        t = (high - low) / np.sqrt(scatter * (1.0 / w[:k].sum() + 1.0 / w[k:].sum()))
        absent = abs(low) < ONSET_BEFORE * high and w[:k].sum() > ONSET_KNOWN * w.sum()
        if absent and t > ONSET_T and (best is None or t > best[0]):
            best = (float(t), k)
    return None if best is None else best[1]
