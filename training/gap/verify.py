"""Is the gap smaller on drives that no fit saw, is no regime worse, are faults still found?"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.errors import ConfigError, ModelError
from monitor.faults import Fault
from monitor.types import FloatArray, IntArray
from training.chain import Constants
from training.gap import detection, ridge
from training.gap.compared import BLOCK_S, FOLDS, Compared
from training.gap.detection import FAULTS, monitor_of
from training.gap.drives import Drive, from_recording
from training.gap.error_regimes import compare, rms, scored
from training.gap.healthy import columns
from training.gap.predicted import predicted_phi
from training.gap.verified import Error, Found, Verified
from training.recordings import Recording

Progress = Callable[[str], None]
AFTERWARDS: Final = (
    "The faults were put on the measured lambda afterwards: the control loop has not seen them and "
    "did not answer, as it would in a car."
)


def verify(
    old: Path,
    new: Path | None,
    recordings: Sequence[Recording],
    healthy: Sequence[Recording] = (),
    *,
    chain: Constants,
    faults: Sequence[Fault] = FAULTS,
    progress: Progress = lambda _: None,
) -> Verified:
    """Return errors and detection of the old and the new model.

    recordings : of the vehicle with the gap, not used by any fit of either model
    healthy : on which the old model was accepted
    chain : base constants of the vehicle, for the functions of the floor
    faults : put on the measured lambda of the recordings; none leaves the monitor out
    Raises RecordingError if a recording cannot be scored.
    """
    progress("errors on held-out recordings")
    overall, regimes = _errors(old, new, recordings, chain)
    on_healthy = _plain(old, new, healthy) if healthy else None
    if not faults:
        return Verified(overall, regimes, on_healthy, (), None, None, ())
    progress("faults put on held-out recordings")
    try:
        before, after = monitor_of(old), None if new is None else monitor_of(new)
    except (ModelError, ConfigError) as error:
        note = f"The monitor was not asked: {error}."
        return Verified(overall, regimes, on_healthy, (), None, None, (note,))
    alarms = detection.alarms(recordings, before, after)
    healthy_alarms = detection.alarms(healthy, before, after) if healthy else None
    found = detection.detect(recordings, faults, before, after)
    notes = (AFTERWARDS, *_short_of_judged(alarms), *_alarmed(alarms))
    return Verified(overall, regimes, on_healthy, found, alarms, healthy_alarms, notes)


def _errors(
    old: Path, new: Path | None, recordings: Sequence[Recording], chain: Constants
) -> tuple[Error, tuple[Error, ...]]:
    drives = [from_recording(r) for r in recordings]
    compared, after = _compared(old, new, recordings, drives)
    both = [[r.residual for r in compared], *([] if after is None else [after])]
    best = min(both, key=lambda residuals: rms(scored(compared, residuals)))
    floor = left_over(drives, compared, best, chain)
    overall, *regimes = compare(compared, after, floor)
    return overall, tuple(regimes)


def _plain(old: Path, new: Path | None, recordings: Sequence[Recording]) -> Error:
    """Return the error of all samples alone, without a floor."""
    drives = [from_recording(r) for r in recordings]
    compared, after = _compared(old, new, recordings, drives)
    whole = compare(compared, after, None)[0]
    return replace(whole, kind="healthy", regime="recordings on which the model was accepted")


def _compared(
    old: Path, new: Path | None, recordings: Sequence[Recording], drives: Sequence[Drive]
) -> tuple[list[Compared], list[FloatArray] | None]:
    """Return the drives with the old model's residuals, and the new model's (n,) of each.

    Both are scored on the same samples.
    """
    before = predicted_phi(old, recordings)
    if new is None:
        return [Compared.of(d, b) for d, b in zip(drives, before, strict=True)], None
    after = predicted_phi(new, recordings)
    drives = [
        replace(d, scored=d.scored & np.isfinite(b) & np.isfinite(a))
        for d, b, a in zip(drives, before, after, strict=True)
    ]
    compared = [Compared.of(d, b) for d, b in zip(drives, before, strict=True)]
    return compared, [Compared.of(d, a).residual for d, a in zip(drives, after, strict=True)]


def left_over(
    drives: Sequence[Drive],
    compared: Sequence[Compared],
    residuals: Sequence[FloatArray],
    chain: Constants,
) -> FloatArray:
    """Return what a flexible model leaves of the scored residuals (m,), the noise floor in phi.

    A ridge on plain functions and every effect's signature, each block by the fit without it. Where
    it helps nothing on the whole the residual itself is left.
    """
    made = [columns(drive, chain) for drive in drives]
    names = [name for name in made[0] if all(name in each for each in made)]
    tables = [np.column_stack([each[name] for name in names]) for each in made]
    x = np.concatenate([t[r.scored] for t, r in zip(tables, compared, strict=True)])
    e = scored(compared, residuals)
    rest = e - ridge.fit(x, e, _folds(compared)).held_out
    return rest if rms(rest) < rms(e) else e


def _folds(compared: Sequence[Compared]) -> IntArray:
    """Return which samples (m,) are held out together: every fifth block of every recording."""
    own = [
        (np.flatnonzero(r.scored) * r.period_s // BLOCK_S).astype(np.int64) + i
        for i, r in enumerate(compared)
    ]
    return np.asarray(np.concatenate(own) % FOLDS)


def _short_of_judged(alarms: Found) -> tuple[str, ...]:
    """Return a note if drives are too short or calm for the monitor to reach a decision."""
    counts = [c for c in (alarms.before, alarms.after) if c is not None]
    least = min(counts, key=lambda c: c.judged)
    if least.judged == least.drives:
        return ()
    return (
        f"In {least.drives - least.judged} of {least.drives} held-out drives the monitor reached "
        "no decision: they are too short or too calm for it. Detection counts them as not found.",
    )


def _alarmed(alarms: Found) -> tuple[str, ...]:
    """Return a note if the old model raises codes without any fault, because of the gap."""
    if not alarms.before.found:
        return ()
    return (
        f"With the old model the monitor raises codes in {alarms.before.found} of "
        f"{alarms.before.drives} held-out drives without any fault: there its detection says "
        "little, the share named right says more.",
    )
