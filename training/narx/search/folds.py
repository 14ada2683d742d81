"""The folds of a search: each leaves out some recordings, or two blocks of a single one.

A training never sees the samples that its fold leaves out, neither to fit nor to stop. So their
free run judges a structure, and is that of a twin of the model.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import BoolArray
from training.recordings.samples.preparation import HELD_OUT, Prepared, Role

FOLDS: Final = 4  # at most
LIMIT_SAMPLES: Final = 500  # ten windows, with which limits can be set


def withheld(data: Prepared) -> BoolArray:
    """Return the samples (n,) that no training may see, because limits are set by them.

    They are the test blocks. If these are too short for limits, the validation blocks are withheld,
    too; if both together are too short, none is.
    """
    for roles in (HELD_OUT[1:], HELD_OUT):
        rows = np.isin(data.role, roles)
        if (data.enabled & rows).sum() >= LIMIT_SAMPLES:
            return rows
    return np.zeros(len(data.role), dtype=bool)


def fold(data: Prepared, kept: BoolArray, left_out: BoolArray) -> Prepared:
    """Return the data for a training: samples that are left out test it, kept ones weigh nothing.

    kept, left_out : (n,) of the samples
    """
    weight = np.where(kept, 0.0, data.samples.weight)
    role = np.where(left_out, Role.TEST, Role.TRAIN).astype(data.role.dtype)
    return replace(data, samples=replace(data.samples, weight=weight), role=role)


def groups_of(data: Prepared) -> list[BoolArray]:
    """Return the rows (n,) that each fold leaves out, at most four groups of recordings.

    One recording is cut into eight blocks, of which each group has two that lie apart: a single
    one would leave out an operating range more often.
    """
    owner = np.concatenate([np.full(s.stop - s.start, s.recording) for s in data.segments])
    numbers = np.unique(owner)
    if len(numbers) == 1:
        block = 2 * FOLDS * np.arange(len(owner)) // len(owner)
        return [block % FOLDS == number for number in range(FOLDS)]
    groups = np.array_split(numbers, min(len(numbers), FOLDS))
    return [np.isin(owner, group) for group in groups]


def longest_left_out(each: Prepared) -> int:
    """Return the samples of the longest stretch of a segment that a fold leaves out."""
    stretches = (
        np.flatnonzero(each.role[s.start : s.stop] == Role.TEST)
        for s in each.segments
        if each.samples.weight[s.start : s.stop].any()
    )
    return max((int(own[-1]) + 1 for own in stretches if len(own)), default=0)
