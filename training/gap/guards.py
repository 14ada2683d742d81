"""What speaks against naming an effect: too little left explained, an onset, a sensor at fault."""

from typing import Final

import numpy as np

from monitor.types import FloatArray, IntArray
from training.chain import Constants
from training.gap.fitting import Case, Fit
from training.gap.sensor_faults import SensorFault

# A sensor that shifted by less is no suspect: DESIGN, "what a prototype taught".
SMALLEST: Final = {"time": 0.020, "gain": 0.02, "offset": 0.004}
ONSET_T: Final = 5.0
ONSET_BEFORE: Final = 0.25  # of the strength after, below which it was absent before
ONSET_BLOCKS: Final = 3  # at least, on either side


GAIN_SHIFT: Final = 0.004  # DESIGN, "what a prototype taught"
TIME_SHIFT_S: Final = 0.020
REFERENCE_RPM: Final = 1500.0


def shifted(reference: Constants, refitted: Constants) -> str | None:
    """Return what of the base left its healthy reference, None if nothing did.

    Time is dead time at 1,500 rpm and both lags together: data hold the sum best.
    """
    change = np.array(refitted) - np.array(reference)
    moved = dict(zip(Constants._fields, change.tolist(), strict=True))
    dead_time_s = moved["dead_time_s"] + moved["dead_time_revolutions"] * 60.0 / REFERENCE_RPM
    if abs(dead_time_s + moved["mixing_s"] + moved["sensor_s"]) > TIME_SHIFT_S:
        return "the lag or dead time"
    return "the gain" if abs(moved["gain"]) > GAIN_SHIFT else None


def large_enough(fault: SensorFault, parameters: FloatArray) -> bool:
    """Whether a fitted sensor fault is more than a piece's or a drive's own variation."""
    around = {"gain": 1.0}
    return any(
        abs(value - around.get(p.name, 0.0)) > SMALLEST[p.name]
        for p, value in zip(fault.parameters, parameters, strict=True)
    )


def onset_s(case: Case, before: Fit, after: Fit) -> tuple[str, float] | None:
    """Return the drive and time at which what ``after`` explains began, None if always there.

    Every block says how strong the explanation is in it; a step from nothing to something within
    a drive, with a t above 5 for the best place of the step, is an onset.
    """
    signature = after.residual - before.residual
    first = 0
    for drive, kept in zip(case.drives, case.kept, strict=True):
        stop = first + int(kept.sum())
        block = case.blocks[first:stop]
        place = _step(-before.residual[first:stop], signature[first:stop], block - block[0])
        if place is not None:
            sample = np.flatnonzero(kept)[np.searchsorted(block - block[0], place)]
            return drive.name, float(sample) * drive.period_s
        first = stop
    return None


def _step(wanted: FloatArray, signature: FloatArray, block: IntArray) -> int | None:
    """Return the block at which the strength steps up from nothing."""
    weight = np.bincount(block, signature**2)
    strength = np.bincount(block, wanted * signature) / np.maximum(weight, 1e-12)
    used = np.flatnonzero(weight > 1e-3 * weight.sum())
    if len(used) < 2 * ONSET_BLOCKS:
        return None
    w, a = weight[used], strength[used]
    best: tuple[float, int] | None = None
    for k in range(ONSET_BLOCKS, len(used) - ONSET_BLOCKS + 1):
        low, high = np.average(a[:k], weights=w[:k]), np.average(a[k:], weights=w[k:])
        left = np.concatenate([a[:k] - low, a[k:] - high])
        scatter = max(float((w * left**2).sum()) / (len(used) - 2), 1.0)
        t = (high - low) / np.sqrt(scatter * (1.0 / w[:k].sum() + 1.0 / w[k:].sum()))
        absent = abs(low) < ONSET_BEFORE * high
        if absent and t > ONSET_T and (best is None or t > best[0]):
            best = (float(t), int(used[k]))
    return None if best is None else best[1]
