"""The answer where no effect can be tried: where the model is wrong, and whether more than before.

The library's effects act on the chain of charge and fuel. Recordings without fuel or air per stroke
can still say in which regime, band or at what time a network is wrong, and with healthy recordings
in what the reading differs from that of a healthy vehicle. So can any output other than lambda.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from monitor.model.card import ModelCard
from training.gap.config import CONFIG
from training.gap.inputs import suitability
from training.gap.name.verdict import Answer, BlockError, Naming, Trials, Verdict
from training.gap.response.difference import Difference, References, difference_of
from training.gap.result import Inputs, ModelFile, Result
from training.gap.where.findings import Findings, localise
from training.greybox.effects import ALL
from training.greybox.fit.comparison import Comparison
from training.greybox.fit.drive import AFTER_CUT_S, AFTER_GAP_S, Drive, make
from training.jobs.checkpoints import Progress
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording, training_recording
from training.recordings.rows import hold

LIMITS: Final = CONFIG.error_alone


def investigate(
    model: Path,
    card: ModelCard,
    recordings: Sequence[Recording],
    healthy: Sequence[Recording],
    missing: Mapping[str, Sequence[str]],
    *,
    sensor_known_good: bool,
    progress: Progress,
) -> Result:
    """Return where the model's free run disagrees, and the verdict that the error alone allows.

    missing : signal that the chain needs → recordings without it
    Raises RecordingError if an input of the model is missing or too little can be scored.
    """
    began_s = time.monotonic()
    progress("localising")
    new, known = (
        [
            Comparison.of(_drive(recording, card), phi)
            for recording, phi in zip(each, predicted_phi(model, each), strict=True)
        ]
        for each in (recordings, healthy)
    )
    found, unit = localise(new, known), _unit(card)
    difference = None
    if len(known) >= CONFIG.response.runs_min:
        progress("comparing runs")
        difference = difference_of(new, References.learn(known, card.input_names), unit)
    optimism = _optimism(found, card, healthy)
    answer = _naming(found, difference, missing, optimism, sensor_known_good)
    return Result(
        inputs=Inputs(
            model=ModelFile.of(model, card),
            recordings=tuple(map(training_recording, recordings)),
            healthy=tuple(map(training_recording, healthy)),
            held_out=(),
            sensor_known_good=sensor_known_good,
            unit=unit,
        ),
        findings=found,
        difference=difference,
        naming=answer,
        unknown=_description(found, difference) if answer.verdict == "unknown_effect" else None,
        warnings=tuple(suitability.poor_model_warnings(card)),
        seconds=time.monotonic() - began_s,
    )


def _unit(card: ModelCard) -> str:
    """Return what errors are in: phi, or the unit of an output that is not lambda."""
    return "phi" if card.transform == "phi" else card.output.unit or f"units of {card.output.name}"


def _description(found: Findings, difference: Difference | None) -> str:
    if difference is None or difference.best is None:
        return " ".join(found.significant)
    return difference.best.sentence


def _optimism(found: Findings, card: ModelCard, healthy: Sequence[Recording]) -> float | None:
    """Return by how much, in phi squared, the model knows healthy recordings that trained it.

    That is the mean square on blocks held out of its training less that on the recordings; None
    if none of them trained it.
    """
    trained = {each.sha256 for each in card.recordings}
    if not trained & {each.sha256 for each in healthy}:
        return None
    figures = card.fit.get("test_enabled") or card.fit.get("test") or {}
    held_out = float(figures.get("rmse_model_units", 0.0))
    return max(held_out**2 - found.excess.reference, 0.0)


def _naming(
    found: Findings,
    difference: Difference | None,
    missing: Mapping[str, Sequence[str]],
    optimism: float | None,
    sensor_known_good: bool,
) -> Naming:
    """Return the verdict; every candidate is skipped."""
    verdict, suspected = _verdict(found, difference, sensor_known_good)
    names = sorted({name for group in missing.values() for name in group})
    why = "" if not missing else f", and {', '.join(names)} cannot give {', '.join(missing)}"
    by = "by the error alone" if difference is None else "by a comparison of runs"
    warnings = [
        "no effect could be tried: the library acts on lambda through the chain of charge and "
        f"fuel{why}; the verdict is {by}"
    ]
    if difference is None and found.excess.relative:
        warnings.append(
            f"{CONFIG.response.runs_min} healthy recordings or more tell how much runs differ "
            "anyway; with fewer, chance is judged within the recordings"
        )
    if not found.excess.relative:
        warnings.append(
            "no healthy recordings: a weakness of the model itself cannot be told from an effect"
        )
    if optimism is not None:
        warnings.append(
            "the model was trained on healthy recordings: its error there is taken to be at least "
            "that on the blocks held out of its training"
        )
    return Naming(
        verdict=verdict,
        answer=Answer(suspected=suspected),
        trials=Trials(skipped={effect.name: tuple(missing) for effect in ALL}),
        base=None,
        error=BlockError(
            before=float(np.sqrt(found.excess.mean_square)),
            after=None,
            floor=found.floor.rms,
            explained_share=nan,
        ),
        warnings=tuple(warnings),
    )


def _verdict(
    found: Findings, difference: Difference | None, sensor_known_good: bool
) -> tuple[Verdict, str | None]:
    """Return the verdict and, if the sensor is suspected, the reason.

    No gap is the answer only if no question that the report shows was answered beyond chance.
    """
    if difference is not None:
        best = difference.best
        suspected = best is not None and difference.like_sensor and not sensor_known_good
        if best is None:
            return "no_gap", None
        return (
            ("sensor_fault_suspected", best.sentence.rstrip("."))
            if suspected
            else ("unknown_effect", None)
        )
    if not found.significant:
        return "no_gap", None
    change = next((c for c in found.changes if c.significant), None)
    if change is not None and not sensor_known_good:
        return "sensor_fault_suspected", change.sentence.rstrip(".")
    return "unknown_effect", None


def _drive(recording: Recording, card: ModelCard) -> Drive:
    output = card.output.name
    columns = {name: recording.column(name) for name in recording.names if name != output}
    present = {name: x for name, x in columns.items() if np.isfinite(x).any()}
    reading = recording.column(output)
    others = {n: x for n, x in present.items() if n in card.input_names or not _same(x, reading)}
    if card.transform != "phi":
        return _plain_drive(recording, others, reading)
    drive = make(
        recording.path.name,
        recording.period_ns / 1e9,
        others,
        reading,
        needed=card.input_names,
    )
    if "fuel_cut" in present or "fuel_mass_mg" in present:
        return drive
    cut = _about(
        drive.phi_measured < LIMITS.lean_phi, LIMITS.before_cut_s, AFTER_CUT_S, drive.period_s
    )
    return replace(drive, scored=drive.scored & ~cut)


def _plain_drive(
    recording: Recording, signals: Mapping[str, FloatArray], reading: FloatArray
) -> Drive:
    """Return a drive of an output other than lambda: every sample with a reading is scored."""
    period_s = recording.period_ns / 1e9
    scored = np.isfinite(reading)
    scored[: round(AFTER_GAP_S / period_s)] = False
    return Drive(
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


def _about(bad: BoolArray, before_s: float, after_s: float, period_s: float) -> BoolArray:
    """Return (n,): bad within ``before_s`` to come or ``after_s`` gone by.

    >>> bad = np.array([False, False, True, False, False, False])
    >>> _about(bad, 0.1, 0.2, 0.1).tolist()
    [False, True, True, True, True, False]
    """
    ahead, behind = round(before_s / period_s), round(after_s / period_s)
    counts = np.concatenate([[0], np.cumsum(bad)])
    at = np.arange(len(bad))
    last = np.minimum(at + ahead + 1, len(bad))
    return np.asarray(counts[last] - counts[np.maximum(at - behind, 0)] > 0)
