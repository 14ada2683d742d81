"""The answer where no effect can be tried: in what runs differ from those of the healthy vehicle.

The library's effects act on the chain of charge and fuel. Recordings without fuel or air per stroke
can still say in what the reading differs from that of a healthy vehicle. So can any output other
than lambda.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from training.gap.config import CONFIG
from training.gap.inputs import suitability
from training.gap.inputs.roles import Material
from training.gap.name.verdict import Answer, BlockError, Naming, Trials, Verdict
from training.gap.response.difference import Difference, difference_of
from training.gap.response.reference import ResponseReference
from training.gap.result import Inputs, Result
from training.greybox.chain import RECOVERY_S
from training.greybox.effects import LIBRARY
from training.greybox.fit.drive import AFTER_GAP_S, ChainDrive, Comparison, make, until
from training.jobs import Progress
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording
from training.recordings.samples.preparation import readings
from training.recordings.samples.rows import hold

LIMITS: Final = CONFIG.error_alone
RUNS_MIN: Final = CONFIG.response.runs_min


def investigate(
    material: Material,
    card: ModelCard,
    missing: Mapping[str, Sequence[str]],
    *,
    sensor_known_good: bool,
    progress: Progress,
) -> Result:
    """Return in what the recordings differ from the healthy ones, and the verdict that allows.

    material : recordings that verify are compared like the others
    missing : signal that the chain needs → recordings without it
    Raises RecordingError if healthy recordings are too few, an input of the model is missing or too
    little can be scored.
    """
    model, healthy = material.model, material.healthy
    recordings = (*material.recordings, *material.verify)
    if len(healthy) < RUNS_MIN:
        raise RecordingError(
            f"{model}: {_untried(missing)}; to compare runs with healthy ones (--healthy, "
            f"{len(healthy)} here), {RUNS_MIN} or more are wanted"
        )
    began_s = time.monotonic()
    progress("comparing runs")
    new, known = (_beside(model, card, each) for each in (recordings, healthy))
    for role, runs in (("new", new), ("healthy", known)):
        suitability.check_long(runs, role)
    error = float(np.sqrt(np.mean(np.concatenate([r.residual[r.scored] for r in new]) ** 2)))
    unit = "phi" if card.transform == "phi" else card.output.unit or f"units of {card.output.name}"
    reference = ResponseReference.learn(known, card.input_names)
    difference = difference_of(new, reference, unit)
    verdict, suspected = _verdict(difference, sensor_known_good=sensor_known_good)
    best = difference.best
    return Result(
        inputs=Inputs.of(model, card.kind, material.roles.values(), sensor_known_good, unit),
        difference=difference,
        naming=Naming(
            verdict=verdict,
            answer=Answer(suspected=suspected),
            trials=Trials(skipped=dict.fromkeys(LIBRARY, tuple(missing)) if missing else {}),
            base=None,
            error=BlockError(before=error, after=None, floor=reference.error, explained_share=nan),
            warnings=(f"{_untried(missing)}; the verdict is by a comparison of runs",),
        ),
        unknown=best.sentence if best is not None and verdict == "unknown_effect" else None,
        warnings=(
            *suitability.poor_model_warnings(card),
            *suitability.seen_in_fit_warnings(card, material),
        ),
        seconds=time.monotonic() - began_s,
    )


def _beside(model: Path, card: ModelCard, recordings: Sequence[Recording]) -> list[Comparison]:
    """Return recordings beside the model's free run."""
    return [
        Comparison.of(_drive(recording, card), phi)
        for recording, phi in zip(recordings, predicted_phi(model, recordings), strict=True)
    ]


def _untried(missing: Mapping[str, Sequence[str]]) -> str:
    """Return that no effect could be tried, and why: the output, or what recordings lack."""
    names = sorted({name for group in missing.values() for name in group})
    why = "" if not missing else f", and {', '.join(names)} cannot give {', '.join(missing)}"
    return f"no effect could be tried: the library acts on lambda through charge and fuel{why}"


def _verdict(difference: Difference, *, sensor_known_good: bool) -> tuple[Verdict, str | None]:
    """Return the verdict and, if the sensor is suspected, the reason."""
    best = difference.best
    if best is None:
        return "no_gap", None
    if difference.like_sensor and not sensor_known_good:
        return "sensor_fault_suspected", best.sentence[0].lower() + best.sentence[1:].rstrip(".")
    return "unknown_effect", None


def _drive(recording: Recording, card: ModelCard) -> ChainDrive:
    output = card.output.name
    columns = {name: recording.column(name) for name in recording.names if name != output}
    present = {name: x for name, x in columns.items() if np.isfinite(x).any()}
    reading = readings(recording, output)
    others = {n: x for n, x in present.items() if n in card.input_names or not _same(x, reading)}
    if card.transform != "phi":
        return _plain_drive(recording, others, reading)
    drive = make(
        recording.path.name, recording.period_ns / 1e9, others, reading, needed=card.input_names
    )
    if "fuel_cut" in present or "fuel_mass_mg" in present:
        return drive
    lean = drive.phi_measured < LIMITS.lean_phi
    cut = until(lean, RECOVERY_S, drive.period_s)
    before = until(lean[::-1], LIMITS.before_cut_s, drive.period_s)[::-1]
    return replace(drive, scored=drive.scored & ~cut & ~before)


def _plain_drive(
    recording: Recording, signals: Mapping[str, FloatArray], reading: FloatArray
) -> ChainDrive:
    """Return a drive of an output other than lambda: every sample with a reading is scored."""
    period_s = recording.period_ns / 1e9
    scored = np.isfinite(reading)
    scored[: round(AFTER_GAP_S / period_s)] = False
    return ChainDrive(
        name=recording.path.name,
        period_s=period_s,
        signals={name: hold(x) for name, x in signals.items()},
        phi_measured=hold(reading),
        scored=scored,
    )


def _same(signal: FloatArray, reading: FloatArray) -> bool:
    """Return whether a signal (n,) is the reading (n,) or its inverse by another name."""
    both = np.isfinite(signal) & np.isfinite(reading) & (reading > 0.0)
    if both.sum() < 2 or np.ptp(signal[both]) == 0.0 or np.ptp(reading[both]) == 0.0:
        return False
    x, y = signal[both], reading[both]
    return max(abs(np.corrcoef(x, each)[0, 1]) for each in (y, 1.0 / y)) > LIMITS.same_correlation
