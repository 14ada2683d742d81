"""One case: its recordings made, the workflow asked, the answer as a row.

The gap of a case is how far what is hidden moves the error of the base that was fitted to the
vehicle's healthy recordings: the RMS, in phi over samples scored in both, of the difference between
its error on the drives and on the same drives and seeds with nothing hidden. The noise is what the
naming's ceiling leaves of the residual of the healthy recordings (``scoring.floor_phi``). The
excess, of which a new model takes a share away, is the mean squared error on the recordings that
the workflow holds out, less that of the same base, fitted alike, on the same drives with nothing
hidden. A base of the case's own recordings is fitted to those that are not held out.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from monitor.base.faults import Fault
from monitor.base.types import FloatArray
from training.gap.healthy.behaviour import Healthy
from training.gap.inputs import base
from training.gap.inputs.roles import FAULTS, Material, Options
from training.gap.name import scoring, yardstick
from training.gap.name.base_state import base_state
from training.gap.result import Result
from training.gap.verify.evidence import Detection, Verification
from training.gap.workflow import investigate
from training.greybox.effects import ALL
from training.greybox.fit.drive import from_recording
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording
from training.studies.gap import drive
from training.studies.gap.base import fit_base
from training.studies.gap.plan import Case, Study, healthy_parts

Row = dict[str, Any]
# A network that was trained on the effect has to be trained anew; the command takes three minutes.
RETRAIN_MINUTES: Final = 0.5
RANKED: Final = 5  # candidates of the last step that a row keeps
# The workflow adds what may be a fault only if told to, and is told so in every case.
ADD: Final = tuple(effect.name for effect in ALL if effect.tag == "fault-like")


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Base model, healthy recordings and noise of one vehicle, for all its cases."""

    number: int
    model: Path  # the base, fitted to the healthy recordings
    healthy: tuple[Recording, ...]
    known: Healthy
    noise_phi: float


def prepare(study: Study, number: int, model: Path) -> Vehicle:
    """Return a vehicle with its healthy behaviour; the base goes to the file ``model``.

    Where bases are fitted to the cases' own recordings it is taught without this base's charge.
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


def ask(
    material: Material,
    known: Healthy,
    steps: int,
    faults: tuple[Fault, ...],
    sensor_known_good: bool = False,
    retrain_minutes: float = 0.0,
) -> Result:
    """Return the workflow's answer; ``faults`` are put on to see that they are still found."""
    with TemporaryDirectory() as out:
        options = Options(
            steps, sensor_known_good, ADD, retrain_minutes, faults=faults, localise=False
        )
        return investigate(material, Path(out), options, known=known)


def run(case: Case, study: Study, vehicle: Vehicle | str) -> Row:
    """Return the case's row; an error of the case or its vehicle is part of the row."""
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


def _answered(case: Case, study: Study, vehicle: Vehicle) -> Row:
    recordings = drive.recordings(case, study.duration_s)
    nothing = recordings
    if case.hidden or case.fault:
        nothing = drive.recordings(case, study.duration_s, hidden=False)
    with TemporaryDirectory() as folder:
        model = reference = vehicle.model
        if study.fitted_with_effect:
            model, reference = Path(folder) / "base.onnx", Path(folder) / "reference.onnx"
            seen = Material(model, recordings, vehicle.healthy).fit_numbers
            fit_base(study.base, [recordings[i] for i in seen], model)
            fit_base(study.base, [nothing[i] for i in seen], reference)
        began_s = time.perf_counter()
        steps, faults = 2 if case.kind == "two" else 1, FAULTS if case.hidden else ()
        material = Material(model, recordings, vehicle.healthy)
        minutes = RETRAIN_MINUTES if study.fitted_with_effect else 0.0
        found = ask(material, vehicle.known, steps, faults, study.sensor_known_good, minutes)
        took_s = time.perf_counter() - began_s
        held_out = {each.sha256 for each in found.held_out}
        pairs = zip(recordings, nothing, strict=True)
        without = rms_phi(reference, [b for a, b in pairs if a.sha256 in held_out])
    gap = moved_phi(vehicle.model, recordings, nothing)
    return {
        **_said(found),
        **_closed(found.verified, without),
        "gap": gap,
        "gap_over_noise": gap / vehicle.noise_phi,
        "seconds": took_s,
    }


def _said(found: Result) -> Row:
    naming, ranking = found.naming, found.naming.ranking
    names = [candidate.name for candidate in naming.effects]
    return {
        "verdict": naming.verdict,
        "names": names if naming.verdict == "named" else [],
        "among": names if naming.verdict == "ambiguous" else [],
        "added": [each.name for each in found.added],
        "suspected": naming.suspected,
        "indistinguishable": [candidate.name for candidate in naming.indistinguishable],
        "runner_up": ranking[1].name if len(ranking) > 1 else None,
        "win": ranking[1].win if len(ranking) > 1 else None,
        "ranking": [
            {k: getattr(c, k) for k in ("name", "score", "needed", "t", "adequacy", "win")}
            for c in ranking[:RANKED]
        ],
        "explained_share": naming.explained_share,
        "noise_floor": naming.noise_floor,
    }


def _closed(verified: Verification | None, without: float) -> Row:
    """Return errors on the held-out recordings, beside the reference ``without`` in phi."""
    if verified is None:
        raise ValueError("nothing was held out")
    before, after = verified.overall.before, verified.overall.after
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
    """Return drives and how many of them each model finds faulty, None without a new model.

    alike : the old model with its limits set as the new one's
    """
    if not any(each.after for each in found):
        return None
    counts = {"drives": sum(each.before.drives for each in found)}
    for name in ("before", "after", "alike"):
        told = [count for each in found if (count := getattr(each, name)) is not None]
        if told:
            counts |= {
                name: sum(count.found for count in told),
                f"{name}_named": sum(count.named for count in told),
            }
    return counts


def moved_phi(model: Path, hidden: Sequence[Recording], nothing: Sequence[Recording]) -> float:
    """Return how far a model's error differs between two series of the same drives, RMS in phi."""
    errors = _errors(model, [*hidden, *nothing])  # side by side
    pairs = zip(errors[: len(hidden)], errors[len(hidden) :], strict=True)
    moved = np.concatenate([x - y for x, y in pairs])
    return float(np.sqrt(np.nanmean(moved**2)))


def rms_phi(model: Path, recordings: Sequence[Recording]) -> float:
    """Return the RMS of a model's error on scored samples, in phi."""
    return float(np.sqrt(np.nanmean(np.concatenate(_errors(model, recordings)) ** 2)))


def _errors(model: Path, recordings: Sequence[Recording]) -> list[FloatArray]:
    """Return the model's error over each recording, (n,) in phi, NaN where not scored."""
    run = predicted_phi(model, recordings)
    made = [from_recording(each) for each in recordings]
    return [
        np.where(d.scored, phi - d.phi_measured, np.nan) for d, phi in zip(made, run, strict=True)
    ]
