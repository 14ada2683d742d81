"""Something that begins within the recordings: a candidate that is absent before a block of time.

Files may not come as they were driven, so drives are also looked at in the order of the candidate's
strength in them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.name.evidence import Directions, SeenErrors
from training.greybox.fit.case import Case
from training.greybox.fit.joint import JointFit
from training.healthy import scoring

BLOCKS_LEAST: Final = 3  # on either side
TRIED: Final = 8  # beginnings of one candidate that explain most


@dataclass(frozen=True, slots=True)
class Beginning:
    """A candidate that is there from one block on, with the strength that fits best."""

    place: tuple[str, float]  # drive, and seconds in it
    seen: SeenErrors  # errors that are left
    gained: float  # sum of squares that it explains, in sigma
    among: int  # beginnings that were looked at


def beginnings(
    case: Case, before: JointFit, after: JointFit, directions: Directions, seen: SeenErrors
) -> Iterator[Beginning]:
    """Yield the beginnings of the last term of ``after`` that explain most.

    before : the fit without it; seen : what it leaves
    """
    blocks = case.blocks
    rest = np.clip(before.residual, -scoring.LARGEST, scoring.LARGEST)
    change = np.clip(after.residual, -scoring.LARGEST, scoring.LARGEST) - rest
    wanted = _sums(-rest * change, blocks)
    power = _sums(change**2, blocks)
    parts = np.zeros((len(power), len(directions.share)))
    np.add.at(parts, blocks, directions.basis * change[:, np.newaxis])
    drive_of, places = _places(case, blocks)
    for order in _orders(drive_of, wanted, power):
        gained, moved = _from_here(wanted[order]), _from_here(power[order])
        cut = _from_here(parts[order])
        inside = np.arange(len(order))
        good = (gained > 0.0) & (moved > 0.0) & (inside >= BLOCKS_LEAST)
        good &= inside <= len(order) - BLOCKS_LEAST
        size = np.where(good, gained / np.where(good, moved, 1.0), 0.0)
        for k in np.argsort(-size * gained)[:TRIED]:
            if not good[k]:
                continue
            squares = float(seen.squares) - float(size[k] * gained[k])
            left = SeenErrors(seen.parts + size[k] * cut[k], squares)
            own = float(size[k] ** 2 * moved[k])
            yield Beginning(places[order[k]], left, own, len(order))


def _sums(values: FloatArray, blocks: IntArray) -> FloatArray:
    return np.asarray(np.bincount(blocks, values), dtype=np.float64)


def _from_here(values: FloatArray) -> FloatArray:
    """Return the sum of each row and all later ones."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


def _places(case: Case, blocks: IntArray) -> tuple[IntArray, list[tuple[str, float]]]:
    """Return each block's drive (n_blocks,), and its drive's name and beginning in s."""
    numbers, places, first = [], list[tuple[str, float]](), 0
    for i, (drive, kept) in enumerate(zip(case.drives, case.kept, strict=True)):
        own = blocks[first : first + int(kept.sum())]
        first += len(own)
        _, begins = np.unique(own, return_index=True)
        times = (np.flatnonzero(kept)[begins] * drive.period_s).tolist()
        places += [(drive.name, t_s) for t_s in times]
        numbers += [i] * len(times)
    return np.array(numbers), places


def _orders(drive_of: IntArray, wanted: FloatArray, power: FloatArray) -> list[IntArray]:
    """Return the blocks in the order given, and with drives in the order of their strength."""
    plain = np.arange(len(drive_of))
    strength = np.bincount(drive_of, wanted) / np.maximum(np.bincount(drive_of, power), 1e-12)
    return [plain, np.asarray(np.lexsort((plain, strength[drive_of])))]
