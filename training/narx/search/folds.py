"""The folds of a search: the same samples, each time with other blocks that choose and stop.

The blocks of the test, which set the limits, stay unseen.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from training.narx.search.structure import LADDERS
from training.recordings.samples.preparation import Prepared, Role

LIMIT_SAMPLES: Final = 500  # ten windows, with which limits can be set


def folds_of(data: Prepared, others: Iterable[Prepared]) -> list[Prepared]:
    """Return the data, and again with the validation blocks of each of the others.

    others : the same samples with other blocks held out
    """
    folds, scored = [data], _scored(data)
    for other in others:
        role = np.where(other.role == Role.VALIDATE, other.role, np.int8(Role.TRAIN))
        role[data.role == Role.TEST] = Role.TEST
        fold = replace(data, role=role)
        if scored and 2 * _scored(fold) >= scored:  # the test may leave nothing of other blocks
            folds.append(fold)
    return folds


def _scored(data: Prepared) -> int:
    """Return the validation samples that even the longest memory lets score."""
    late = np.zeros(len(data.role), dtype=bool)
    for segment in data.segments:
        late[segment.start + LADDERS["longest"][-1] : segment.stop] = True
    held_out = (data.role == Role.VALIDATE) & (data.samples.weight > 0.0)
    return int((held_out & late).sum())


def free_folds(folds: list[Prepared]) -> int:
    """Return the number of folds that may be trained on: one if the limits need its blocks.

    They do where the blocks of the test alone are too short to set limits, and both together are
    long enough.
    """
    data = folds[0]
    counts = [int((data.enabled & (data.role == role)).sum()) for role in Role]
    test = counts[Role.TEST]
    is_free = test >= LIMIT_SAMPLES or test + counts[Role.VALIDATE] < LIMIT_SAMPLES
    return len(folds) if is_free else 1


def trained_on_all(data: Prepared) -> Prepared:
    """Return the data with the validation blocks among those that train."""
    role = np.where(data.role == Role.VALIDATE, Role.TRAIN, data.role).astype(data.role.dtype)
    return replace(data, role=role)
