"""One recording with what a model predicted for it, and blocks of time to resample."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, FloatArray, IntArray
from training.greybox.chain import Path
from training.greybox.fit.drive import Drive

BLOCK_S = 30.0  # one block: many cycles of the lambda controller and a manoeuvre or two
LEAST_BLOCKS = 10  # with fewer, no statistic over blocks is worth its name


@dataclass(frozen=True, slots=True)
class Comparison:
    """A drive with the free run of the model on it, in phi on the model's grid.

    ``dead_time_s`` and ``lag_s`` are what the model's own chain says of the way from the engine to
    the sensor; None where the model has no such chain.
    Raises RecordingError if the lengths differ.
    """

    name: str
    period_s: float
    signals: Mapping[str, FloatArray]  # canonical names, each (n,), NaN where not good
    phi_measured: FloatArray  # (n,)
    phi_predicted: FloatArray  # (n,)
    scored: BoolArray  # (n,) enabled, outside fuel cut and its recovery
    dead_time_s: FloatArray | None = None  # (n,)
    lag_s: float | None = None
    residual: FloatArray = field(init=False)  # (n,) measured minus predicted, 0 where not scored

    @classmethod
    def of(cls, drive: Drive, phi_predicted: FloatArray, path: Path | None = None) -> "Comparison":
        """Return a drive with a model's prediction (n,) of its phi, and the path of its chain."""
        return cls(
            drive.name,
            drive.period_s,
            drive.signals,
            drive.phi_measured,
            phi_predicted,
            drive.scored,
            path.dead_time_s if path else None,
            float(np.median(path.mixing_s + path.sensor_rising_s)) if path else None,
        )

    def __post_init__(self) -> None:
        n = len(self.phi_measured)
        others = {
            "predicted phi": self.phi_predicted,
            "scored samples": self.scored,
            **self.signals,
        }
        if self.dead_time_s is not None:
            others["dead time"] = self.dead_time_s
        for what, values in others.items():
            if values.shape != (n,):
                raise RecordingError(
                    f"{self.name}: {what} has shape {values.shape}, wanted ({n},) as measured phi"
                )
        difference = self.phi_measured - self.phi_predicted
        scored = self.scored & np.isfinite(difference)
        object.__setattr__(self, "scored", scored)
        object.__setattr__(self, "residual", np.where(scored, difference, 0.0))


@dataclass(frozen=True, slots=True)
class Stack:
    """The scored samples of several recordings one after the other."""

    residual: FloatArray  # (m,)
    block: IntArray  # (m,) number of the block of time, 0 to n_blocks - 1
    fold: IntArray  # (n_blocks,) which blocks are held out together
    recording: IntArray  # (n_blocks,)
    rows: tuple[IntArray, ...]  # scored rows of each recording

    @property
    def n_blocks(self) -> int:
        """Return the number of blocks."""
        return len(self.fold)

    def sums(self, values: FloatArray) -> FloatArray:
        """Return the sums of ``values`` (m,) over each block, (n_blocks,)."""
        return np.asarray(np.bincount(self.block, values, self.n_blocks), dtype=np.float64)


FOLDS = 5


def stack(recordings: Sequence[Comparison], block_s: float = BLOCK_S) -> Stack:
    """Return the scored samples with their blocks.

    From ``FOLDS`` recordings on whole recordings are held out, because what is peculiar to one
    drive must not count as known; with fewer, every fifth pair of blocks.
    Raises RecordingError if there are too few scored samples for a statistic over blocks.
    """
    residual, block, fold, recording, rows = [], [], [], [], []
    n_blocks = 0
    for i, each in enumerate(recordings):
        kept = np.flatnonzero(each.scored)
        number = (kept * each.period_s // block_s).astype(np.int64)
        used, own = np.unique(number, return_inverse=True)
        residual.append(each.residual[kept])
        block.append(own + n_blocks)
        fold.append(
            np.full(len(used), i % FOLDS) if len(recordings) >= FOLDS else (used // 2) % FOLDS
        )
        recording.append(np.full(len(used), i))
        rows.append(kept)
        n_blocks += len(used)
    if n_blocks < LEAST_BLOCKS:
        raise RecordingError(
            f"{', '.join(r.name for r in recordings) or 'no recording'}: scored samples in "
            f"{n_blocks} blocks of {block_s:g} s, at least {LEAST_BLOCKS} are wanted"
        )
    return Stack(
        np.concatenate(residual),
        np.concatenate(block).astype(np.int64),
        np.concatenate(fold).astype(np.int64),
        np.concatenate(recording).astype(np.int64),
        tuple(rows),
    )


def gather(arrays: Sequence[FloatArray], to: Stack) -> FloatArray:
    """Return the scored rows of one array per recording, (m,) or (m, k)."""
    return np.concatenate([a[rows] for a, rows in zip(arrays, to.rows, strict=True)])
