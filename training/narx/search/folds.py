"""The folds of a search: the same samples, each time with other blocks that choose and stop."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from training.narx.search.structure import LADDERS
from training.recordings.samples.preparation import Prepared, Role


def folds_of(data: Prepared, others: Iterable[Prepared]) -> list[Prepared]:
    """Return the data, and again with the validation blocks of each of the others.

    others : the same samples with other blocks held out
    """
    folds, scored = [data], _scored(data)
    for other in others:
        held_out = np.where(other.role == Role.VALIDATE, other.role, np.int8(Role.TRAIN))
        fold = replace(data, role=np.where(data.role == Role.TEST, data.role, held_out))
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
