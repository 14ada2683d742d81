"""The check of a new model: a smaller gap on unseen drives, no regime worse, faults still found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import ConfigError, ModelError
from monitor.base.faults import Fault
from monitor.base.types import FloatArray
from monitor.model.step import Model
from training.gap.inputs.roles import FAULTS
from training.gap.verify.detection import detect, monitor_of
from training.gap.verify.error_curve import error_curve
from training.gap.verify.error_regimes import blocks_of, compare, rms, scored
from training.gap.verify.evidence import Error, ErrorTrace, Verification
from training.greybox.chain import Constants
from training.greybox.fit import ridge
from training.greybox.fit.drive import FOLDS, ChainDrive, Comparison
from training.greybox.graph.chain_graph import Greybox
from training.healthy.base import GREYBOX, check, plain_drives_of
from training.healthy.behaviour import columns, common
from training.jobs import Progress
from training.recordings.prediction import checked, predicted_phi
from training.recordings.recording import Recording

TRACE_S: Final = 40.0
AFTERWARDS: Final = (
    "The faults were put on the measured lambda afterwards: the control loop has not seen them and "
    "did not answer, as it would in a car."
)


@dataclass(frozen=True, slots=True)
class Fold:
    """Recordings, and the new model whose constants have not seen them."""

    new: Path | None
    recordings: Sequence[Recording]


def verify(
    old: Path,
    folds: Sequence[Fold],
    healthy: Sequence[Recording] = (),
    *,
    chain: Constants,
    new: Path | None = None,
    faults: Sequence[Fault] = FAULTS,
    progress: Progress = lambda _: None,
) -> Verification:
    """Return errors and detection of the old and the new model.

    folds : of the vehicle with the gap
    healthy : on which the old model was accepted
    chain : base constants of the vehicle, for the functions of the floor
    new : from all recordings, for the healthy ones; None if there is no new model
    faults : put on the measured lambda of the recordings; none leaves the monitor out
    Raises RecordingError if a recording cannot be scored.
    """
    progress("errors on held-out recordings")
    card, recordings = check(old), [r for fold in folds for r in fold.recordings]
    drives = plain_drives_of(card, recordings)
    before, after = _compared(old, folds, drives)
    overall, regimes = _errors(drives, before, after, chain)
    of_healthy = None
    if healthy:
        of_healthy = _compared(old, [Fold(new, healthy)], plain_drives_of(card, healthy))
    found = Verification(
        overall=overall,
        regimes=regimes,
        healthy=None if of_healthy is None else _plain(*of_healthy),
        trace=_trace(before, after) if after else None,
        curve=error_curve(before, after),
    )
    if not faults:
        return found
    progress("faults put on held-out recordings")
    try:
        monitor = monitor_of(old)
        monitors = [
            (monitor_of(each.new) if each.new else None, each.recordings)
            for each in (*folds, Fold(new, healthy))
        ]
    except (ModelError, ConfigError) as error:
        return replace(found, notes=(f"The monitor was not asked: {error}.",))
    alarms, *detected = detect(monitor, monitors[:-1], faults)
    return replace(
        found,
        faults=tuple(detected),
        alarms=alarms,
        healthy_alarms=detect(monitor, monitors[-1:], ())[0] if healthy else None,
        notes=(AFTERWARDS,),
    )


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
    old: Path, folds: Sequence[Fold], drives: Sequence[ChainDrive]
) -> tuple[list[Comparison], list[Comparison] | None]:
    """Return the drives with each model's prediction, scored on the same samples."""
    before = free_runs(old, [r for fold in folds for r in fold.recordings])
    by_fold = [free_runs(f.new, f.recordings) for f in folds if f.new]
    after = [phi for runs in by_fold for phi in runs]
    scored = [
        d.scored & np.all(np.isfinite(runs), axis=0)
        for d, *runs in zip(drives, before, *([after] if after else []), strict=True)
    ]
    drives = [replace(d, scored=own) for d, own in zip(drives, scored, strict=True)]
    old_runs, new_runs = (
        [Comparison.of(d, phi) for d, phi in zip(drives, runs, strict=bool(runs))]
        for runs in (before, after)
    )
    return old_runs, new_runs or None


def free_runs(model: Path, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Return a model's phi (n,) over each recording: a chain's by the equations of its file.

    Raises RecordingError or ModelError as ``predicted_phi``.
    """
    loaded = Model.load(model)
    if loaded.card.kind != GREYBOX:
        return predicted_phi(model, recordings)
    chain = Greybox.of(loaded.card)
    return [chain.reading(checked(loaded, each)[0]) for each in recordings]


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
    _, tables = common([columns(drive, chain) for drive in drives])
    x = np.concatenate([t[r.scored] for t, r in zip(tables, compared, strict=True)])
    e = scored(compared, residuals)
    rest = e - ridge.fit(x, e, blocks_of(compared) % FOLDS).held_out
    return rest if rms(rest) < rms(e) else e
