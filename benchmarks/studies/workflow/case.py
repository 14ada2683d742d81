"""One case of the gap study: simulate its recordings, run the workflow, return a row.

The base model is fitted like ``o2train fit`` does it.

Every drive is simulated twice with the same seed: with the hidden effect or fault, and without it
(the reference drive). A row measures:

gap : RMS, in phi, of the base model's error on the drives minus its error on the reference drives,
    over the samples scored in both; the base is fitted to the vehicle's healthy recordings
noise : RMS, in phi, of the residual that the naming's flexible model leaves on the healthy
    recordings (``scoring.floor_phi``)
excess : mean squared error on the held-out drives, minus the base's mean squared error on their
    reference drives; a new model should remove it

If the study fits the base to the case's recordings (``Study.fitted_with_effect``), the fit uses
only drives that the workflow does not hold out.
"""

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from benchmarks.studies.workflow import drive
from benchmarks.studies.workflow.plan import Case, Study, healthy_parts
from monitor.base import config
from monitor.base.errors import RecordingError
from monitor.base.signals import NARX_INPUTS, OUTPUT
from monitor.base.types import FloatArray
from training.gap.inputs.roles import FAULTS, GapOptions, Material
from training.gap.result import Result
from training.gap.verify.evidence import Detection, Verification
from training.gap.verify.verification import free_runs
from training.gap.workflow import investigate
from training.greybox.effects import LIBRARY
from training.greybox.fit.drive import from_recording
from training.greybox.model import fit_greybox
from training.healthy import base, scoring, yardstick
from training.healthy.base import GREYBOX
from training.healthy.base_state import base_state
from training.healthy.behaviour import Healthy
from training.limits.decision_limits import with_limits
from training.narx.export import update_card
from training.narx.fit import FitOptions, FitSource, fit
from training.narx.model_file import FreeRunFit
from training.recordings.recording import Recording

BUDGET_MINUTES: Final = 3.0  # upper bound; a training on two hours of driving takes half a minute
LAGS: Final = 5
HIDDEN: Final = (8, 8)
RANKED: Final = 5  # number of candidates that a row keeps of the last naming step
# The workflow adds these fault-like effects only if they are listed; every case lists them.
ADD: Final = tuple(effect.name for effect in LIBRARY.values() if effect.tag == "fault-like")


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Base model, healthy recordings and their statistics, shared by all cases of a vehicle."""

    number: int
    model: Path  # file of the base model, fitted to the healthy recordings
    healthy: tuple[Recording, ...]
    known: Healthy
    noise_phi: float


def fit_base(base: str, recordings: Sequence[Recording], out: Path) -> None:
    """Fit a model of the kind ``base`` (``greybox`` or ``narx``) and write it to ``out``.

    The model gets decision limits if the recordings hold enough windows.
    """
    if base == GREYBOX:
        fitted: FreeRunFit = fit_greybox(recordings, out)
    else:
        options = FitOptions(
            lags=LAGS,
            hidden=HIDDEN,
            input_lag_start=0,
            starts=1,
            budget_minutes=BUDGET_MINUTES,
            threads=1,
        )
        fitted = fit(FitSource(recordings, NARX_INPUTS, OUTPUT), out, options)
    with suppress(RecordingError):  # too few windows: the model stands without limits
        update_card(out, with_limits(fitted.card, *fitted.healthy(), config.load()))


def prepare(study: Study, number: int, model: Path) -> Vehicle:
    """Return a vehicle: its healthy recordings, the base model fitted to them, and the noise.

    model : file to which the base model is written
    If the study fits a base to every case (``fitted_with_effect``), the air charge is taken as
    broadcast and not from this base model.
    """
    made = drive.healthy(healthy_parts(study, number), number, study.duration_s)
    fit_base(study.base, made, model)
    alone = study.fitted_with_effect
    drives = list(map(from_recording, made)) if alone else base.drives_of(model, made)
    known = yardstick.learn(drives, base.constants_of(base.check(model)))
    state = base_state(drives, known, known.base)
    noise_phi = scoring.floor_phi(state.case, state.current)
    return Vehicle(
        number=number, model=model, healthy=tuple(made), known=known, noise_phi=noise_phi
    )


def run(case: Case, study: Study, vehicle: Vehicle | str) -> dict[str, Any]:
    """Return the case's row; an error of the case or of its vehicle is written into the row.

    vehicle : a text instead of a vehicle says why the vehicle could not be prepared
    """
    if isinstance(vehicle, str):
        return case.as_row() | {"noise": None, "error": vehicle}
    row = case.as_row() | {"noise": vehicle.noise_phi, "error": None}
    try:
        answered = _answered(case, study, vehicle)
        if wrong := [k for k, v in answered.items() if isinstance(v, float) and not isfinite(v)]:
            raise ValueError(f"{', '.join(wrong)} not finite")
        return row | answered
    except Exception as error:  # one case must not end a study of many hours
        return row | {"error": f"{type(error).__name__}: {error}"}


def _answered(case: Case, study: Study, vehicle: Vehicle) -> dict[str, Any]:
    recordings = drive.recordings(case, study.duration_s)
    nothing = recordings
    if case.hidden or case.fault:
        nothing = drive.recordings(case, study.duration_s, hidden=False)
    with TemporaryDirectory() as folder:
        model = reference = vehicle.model
        if study.fitted_with_effect:
            model, reference = Path(folder) / "base.onnx", Path(folder) / "reference.onnx"
            n_seen = 2 * len(recordings) // 3
            fit_base(study.base, recordings[:n_seen], model)
            fit_base(study.base, nothing[:n_seen], reference)
            material = Material(model, recordings[:n_seen], vehicle.healthy, recordings[n_seen:])
            nothing = nothing[n_seen:]
        else:
            material = Material(model, recordings, vehicle.healthy)
        options = GapOptions(
            2 if case.kind == "two" else 1,
            study.sensor_known_good,
            ADD,
            faults=FAULTS if case.hidden else (),
        )
        began_s = time.perf_counter()
        found = investigate(material, Path(folder), options, known=vehicle.known)
        took_s = time.perf_counter() - began_s
        without = rms_phi(reference, nothing)
    gap = moved_phi(vehicle.model, recordings[-len(nothing) :], nothing)
    return {
        **_said(found),
        **_closed(found.verified, without, found.addition.withdrawn is not None),
        "gap": gap,
        "gap_over_noise": gap / vehicle.noise_phi,
        "seconds": took_s,
    }


def _said(found: Result) -> dict[str, Any]:
    naming, answer = found.naming, found.naming.answer
    ranking = naming.trials.ranking
    names = [candidate.name for candidate in answer.effects]
    return {
        "verdict": naming.verdict,
        "names": names if naming.verdict == "named" else [],
        "among": names if naming.verdict == "ambiguous" else [],
        "added": [each.name for each in found.addition.effects],
        "withdrawn": found.addition.withdrawn,
        "suspected": answer.suspected,
        "indistinguishable": [candidate.name for candidate in answer.indistinguishable],
        "ranking": [
            {"name": c.name} | {k: getattr(c.merit, k) for k in ("score", "needed", "t")}
            for c in ranking[:RANKED]
        ],
    }


def _closed(verified: Verification | None, without: float, withdrawn: bool) -> dict[str, Any]:
    """Return the errors on the recordings that verify before and after the new model.

    withdrawn : the new model was not written, so the old one's error stays; what the monitor found
        with both is counted all the same
    without : RMS error on the reference drives, in phi
    """
    if verified is None:
        raise ValueError("nothing was held out")
    before, after = verified.overall.before, verified.overall.after
    after = None if withdrawn else after
    return {
        "faults": _counts(verified.faults),
        "alarms": _counts([verified.alarms] if verified.alarms else []),
        "rmse_before": before,
        "rmse_after": after,
        "rmse_without": without,
        "excess_before": before**2 - without**2,
        "excess_after": (before if after is None else after) ** 2 - without**2,
    }


def _counts(found: Sequence[Detection]) -> dict[str, int] | None:
    """Return the number of drives and how many of them each model finds faulty.

    Keys: ``before`` (old model), ``after`` (new model), and the same with ``_named`` for right
    fault names.
    Return None without a new model.
    """
    if not any(each.after for each in found):
        return None
    counts = {"drives": sum(each.before.drives for each in found)}
    for name in ("before", "after"):
        told = [count for each in found if (count := getattr(each, name)) is not None]
        if told:
            counts |= {
                name: sum(count.found for count in told),
                f"{name}_named": sum(count.named for count in told),
            }
    return counts


def moved_phi(model: Path, hidden: Sequence[Recording], nothing: Sequence[Recording]) -> float:
    """Return the RMS difference, in phi, of a model's errors on two series of the same drives."""
    errors = _errors(model, [*hidden, *nothing])  # side by side
    pairs = zip(errors[: len(hidden)], errors[len(hidden) :], strict=True)
    moved = np.concatenate([x - y for x, y in pairs])
    return float(np.sqrt(np.nanmean(moved**2)))


def rms_phi(model: Path, recordings: Sequence[Recording]) -> float:
    """Return the RMS of a model's error over the scored samples, in phi."""
    return float(np.sqrt(np.nanmean(np.concatenate(_errors(model, recordings)) ** 2)))


def _errors(model: Path, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Return the model's error over each recording, (n,) in phi, NaN where not scored."""
    run = free_runs(model, recordings)
    made = [from_recording(each) for each in recordings]
    return [
        np.where(d.scored, phi - d.phi_measured, np.nan) for d, phi in zip(made, run, strict=True)
    ]
