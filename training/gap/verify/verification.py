"""The check of a new model: a smaller gap on unseen drives, no regime worse, faults still found."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import ConfigError, ModelError, RecordingError
from monitor.base.faults import Fault
from monitor.base.types import FloatArray, IntArray
from monitor.model.step import Model
from training.gap.inputs.roles import FAULTS
from training.gap.verify.detection import Monitors, Trial, detect, monitor_of
from training.gap.verify.error_regimes import compare, rms, scored
from training.gap.verify.evidence import Detection, Error, ErrorTrace, Verification
from training.gap.verify.operating_map import operating_map
from training.greybox.chain import Constants
from training.greybox.fit import ridge
from training.greybox.fit.comparison import BLOCK_S, FOLDS, Comparison
from training.greybox.fit.drive import ChainDrive
from training.healthy.base import check, plain_drives_of
from training.healthy.behaviour import columns
from training.jobs import Progress
from training.limits.repeated_model import RepeatedModel
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording

TRACE_S: Final = 40.0
ALIKE: Final = (
    "A new model's limits are set on the recordings of the fit (of a network trained anew on the "
    "blocks held out of its training), by the rule of o2train fit, unless its card says that the "
    "old ones stayed. Beside the old model's own limits stands what it finds with limits set on "
    "the recordings of the fit: with its own it may take the gap for a fault, and then finds every "
    "fault put on, by the wrong name."
)
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
    accepted: Sequence[Recording] = (),
    faults: Sequence[Fault] = FAULTS,
    progress: Progress = lambda _: None,
) -> Verification:
    """Return errors and detection of the old and the new model.

    recordings : of the vehicle with the gap, not used by any fit of either model
    healthy : on which the old model was accepted
    chain : base constants of the vehicle, for the functions of the floor
    accepted : to which the new model was fitted; the old model's limits are set there, beside its
        own: only where both are as quiet does what they find compare
    faults : put on the measured lambda of the recordings; none leaves the monitor out
    Raises RecordingError if a recording cannot be scored.
    """
    progress("errors on held-out recordings")
    card = check(old)
    drives, known = (plain_drives_of(card, each) for each in (recordings, healthy))
    run, run_new = _compared(old, new, [*recordings, *healthy], [*drives, *known])
    n = len(drives)
    before, after = run[:n], run_new and run_new[:n]
    overall, regimes = _errors(drives, before, after, chain)
    found = Verification(
        overall=overall,
        regimes=regimes,
        healthy=_plain(run[n:], run_new and run_new[n:]) if healthy else None,
        trace=_trace(before, after) if after else None,
        map=operating_map(before, after),
    )
    if not faults:
        return found
    progress("faults put on held-out recordings")
    try:
        monitors = _monitors(old, new, accepted)
    except (ModelError, ConfigError) as error:
        return replace(found, notes=(f"The monitor was not asked: {error}.",))
    trials: list[Trial] = [(recordings, None), *((recordings, fault) for fault in faults)]
    alarms, *detected = detect([*trials, (healthy, None)] if healthy else trials, monitors)
    healthy_alarms = detected.pop() if healthy else None
    told = () if monitors.alike is None else (ALIKE,)
    notes = (AFTERWARDS, *told, *_undecided(alarms, detected), *_alarmed(alarms))
    return replace(
        found,
        faults=tuple(detected),
        alarms=alarms,
        healthy_alarms=healthy_alarms,
        notes=notes,
    )


def _monitors(old: Path, new: Path | None, accepted: Sequence[Recording]) -> Monitors:
    model = RepeatedModel.of(Model.load(old))  # judged with two sets of limits
    if new is None:
        return Monitors(monitor_of(model))
    alike = None
    with suppress(RecordingError):  # too few windows to set limits: nothing to compare with
        alike = monitor_of(model, accepted) if accepted else None
    return Monitors(monitor_of(model), monitor_of(Model.load(new)), alike)


def _errors(
    drives: Sequence[ChainDrive],
    before: Sequence[Comparison],
    after: Sequence[Comparison] | None,
    chain: Constants,
) -> tuple[Error, tuple[Error, ...]]:
    """Return the errors of all samples and by regime, with the floor of the better model."""
    both = [[r.residual for r in each] for each in (before, after) if each is not None]
    best = min(both, key=lambda residuals: rms(scored(before, residuals)))
    floor = left_over(drives, before, best, chain)
    overall, *regimes = compare(before, both[1] if after else None, floor)
    return overall, tuple(regimes)


def _plain(before: Sequence[Comparison], after: Sequence[Comparison] | None) -> Error:
    """Return the error of all samples of healthy recordings alone, without a floor."""
    whole = compare(before, [r.residual for r in after] if after else None, None)[0]
    return replace(whole, kind="healthy", regime="healthy recordings")


def _compared(
    old: Path, new: Path | None, recordings: Sequence[Recording], drives: Sequence[ChainDrive]
) -> tuple[list[Comparison], list[Comparison] | None]:
    """Return the drives with each model's prediction, scored on the same samples."""
    before = predicted_phi(old, recordings)
    after = before if new is None else predicted_phi(new, recordings)
    drives = [
        replace(d, scored=d.scored & np.isfinite(b) & np.isfinite(a))
        for d, b, a in zip(drives, before, after, strict=True)
    ]
    old_run, new_run = (
        [Comparison.of(d, phi) for d, phi in zip(drives, each, strict=True)]
        for each in (before, after)
    )
    return old_run, None if new is None else new_run


def _trace(before: Sequence[Comparison], after: Sequence[Comparison]) -> ErrorTrace:
    """Return the stretch in which the new model takes away most of the squared error."""
    best = (-1.0, 0, slice(0))
    for i, (old, new) in enumerate(zip(before, after, strict=True)):
        length = min(round(TRACE_S / old.period_s), len(old.residual))
        total = np.concatenate([[0.0], np.cumsum(old.residual**2 - new.residual**2)])
        sums = total[length:] - total[:-length]
        at = int(np.argmax(sums))
        best = max(best, (float(sums[at]), i, slice(at, at + length)), key=lambda each: each[0])
    _, i, rows = best
    old = before[i]
    return ErrorTrace(
        recording=old.name,
        t_s=np.arange(rows.start, rows.stop, dtype=np.float64) * old.period_s,
        measured=old.phi_measured[rows],
        before=old.phi_predicted[rows],
        after=after[i].phi_predicted[rows],
        scored=old.scored[rows],
    )


def left_over(
    drives: Sequence[ChainDrive],
    compared: Sequence[Comparison],
    residuals: Sequence[FloatArray],
    chain: Constants,
) -> FloatArray:
    """Return the scored residuals (m,) that a flexible model leaves, the noise floor in phi.

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


def _folds(compared: Sequence[Comparison]) -> IntArray:
    """Return which samples (m,) are held out together: every fifth block of every recording."""
    own = [
        (np.flatnonzero(r.scored) * r.period_s // BLOCK_S).astype(np.int64) + i
        for i, r in enumerate(compared)
    ]
    return np.asarray(np.concatenate(own) % FOLDS)


def _undecided(alarms: Detection, found: Sequence[Detection]) -> tuple[str, ...]:
    """Return notes if drives are too short or calm for the monitor to reach a decision."""
    notes = []
    for words, each in (("held-out drives", [alarms]), ("drives with a fault put on", found)):
        counts = [c for f in each for c in (f.before, f.after) if c is not None]
        drives, judged = sum(c.drives for c in counts), sum(c.judged for c in counts)
        if judged < drives:
            notes.append(
                f"In {drives - judged} of {drives} {words}, both models counted, the monitor "
                "reached no decision: too short or too calm for it. They count as not found."
            )
    return tuple(notes)


def _alarmed(alarms: Detection) -> tuple[str, ...]:
    """Return a note if the old model raises codes without any fault, because of the gap."""
    if not alarms.before.found:
        return ()
    return (
        f"With the old model the monitor raises codes in {alarms.before.found} of "
        f"{alarms.before.drives} held-out drives without any fault: there its detection says "
        "little, the share named right says more.",
    )
