"""Drives beside a model's prediction, and blocks of time for statistics over them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, FloatArray, IntArray
from training.greybox.chain import Path
from training.greybox.fit.drive import Drive

BLOCK_S = 30.0  # a block holds many cycles of the lambda controller and a manoeuvre or two
LEAST_BLOCKS = 10  # for a statistic over blocks
FOLDS = 5  # of blocks that are held out together


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A drive beside a model's free run on it, in phi on the model's grid.

    ``dead_time_s`` and ``lag_s`` belong to the model's chain from engine to sensor; they are None
    for a model without a chain.
    Raises RecordingError if the lengths differ.
    """

    name: str
    period_s: float
    signals: Mapping[str, FloatArray]  # canonical name → (n,), NaN where the signal is bad
    phi_measured: FloatArray  # (n,)
    phi_predicted: FloatArray  # (n,)
    scored: BoolArray  # (n,) enabled, outside fuel cut and its recovery
    dead_time_s: FloatArray | None = None  # (n,)
    lag_s: float | None = None
    residual: FloatArray = field(init=False)  # (n,) measured minus predicted, 0 where not scored

    @classmethod
    def of(cls, drive: Drive, phi_predicted: FloatArray, path: Path | None = None) -> "Comparison":
        """Return a drive beside a model's prediction (n,) in phi.

        path : of the model's chain; None for a model without a chain
        """
        return cls(
            name=drive.name,
            period_s=drive.period_s,
            signals=drive.signals,
            phi_measured=drive.phi_measured,
            phi_predicted=phi_predicted,
            scored=drive.scored,
            dead_time_s=path.dead_time_s if path else None,
            lag_s=float(np.median(path.mixing_s + path.sensor_rising_s)) if path else None,
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
    """The scored samples of several recordings, concatenated."""

    residual: FloatArray  # (m,)
    block: IntArray  # (m,) number of the block of time, 0 to n_blocks - 1, never falling
    fold: IntArray  # (n_blocks,) number of the group of blocks that is held out together
    recording: IntArray  # (n_blocks,) number of the recording
    rows: tuple[IntArray, ...]  # scored rows of each recording

    @property
    def n_blocks(self) -> int:
        """Return the number of blocks."""
        return len(self.fold)

    def sums(self, values: FloatArray) -> FloatArray:
        """Return the sums of ``values`` (m,) over each block, (n_blocks,)."""
        return np.asarray(np.bincount(self.block, values, self.n_blocks), dtype=np.float64)


def stack(recordings: Sequence[Comparison], block_s: float = BLOCK_S) -> Stack:
    """Return the scored samples with their blocks.

    With ``FOLDS`` recordings or more, whole recordings are held out, so that the peculiarities of
    one drive do not count as learned; with fewer, every fifth pair of blocks is held out.
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
