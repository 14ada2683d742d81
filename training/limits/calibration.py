"""Decision limits of a model anew, from healthy drives; and what it finds in faulty ones."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from monitor.base.config import Config
from monitor.base.counts import counted
from monitor.base.errors import UsageError
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.limits.decision_limits import with_limits
from training.limits.evaluation import false_alarms
from training.limits.judging import Judged, judge_recordings, why_not
from training.limits.rates import rate
from training.limits.trust import trust_of
from training.recordings.recording import Recording, check_each_once

SCHEMA = "o2train.calibrate/2"
Drives = Sequence[tuple[Recording, Judged]]
FEW_DRIVES = 5  # fewer show little of how drives differ


def calibrate(
    path: Path, healthy: Sequence[Recording], faulty: Sequence[Recording], config: Config
) -> tuple[ModelCard, dict[str, Any]]:
    """Return the model card with new limits, and the figures of the report as JSON values.

    The function writes no file.

    path : model file
    faulty : recordings with a sensor fault; may be empty
    Raises RecordingError if there are fewer than 10 healthy windows, UsageError for a recording
    whose manifest contradicts its role, ConfigError if model and configuration differ in the window
    length.
    """
    _check(healthy, faulty)
    model = Model.load(path)
    origin = f"o2train calibrate, {counted(len(healthy), 'healthy drive')}"
    card = with_limits(model.card, [(model, healthy)], origin, config)
    card = replace(card, trust=trust_of([(model, healthy)], card, config, str(path)))
    limits = Limits.from_card(card, config, str(path))
    good, bad = (
        [*zip(drives, judge_recordings(drives, model, limits, config, rear=True), strict=True)]
        for drives in (healthy, faulty)
    )
    rows, found = ([_row(*drive) for drive in drives] for drives in (good, bad))
    before = model.card.limits
    return card, {
        "schema": SCHEMA,
        "model": path.name,
        "model_sha256": model.sha256,
        "simulated": any(r.entry.get("source") == "simulated" for r in (*healthy, *faulty)),
        "limits": [
            {"name": name, "before": before[name].value if name in before else None, **asdict(own)}
            for name, own in card.limits.items()
        ],
        "needed": config.response.evidence_fail,
        "false_alarms": false_alarms(good, config),
        "found": rate(sum(bool(row["codes"]) for row in found), len(found))
        | {"named": sum(row["named"] == [row["fault"]] for row in found)},
        "healthy": rows,
        "faulty": found,
        "warnings": _warnings(model.card, good, bad, config),
    }


def _check(healthy: Sequence[Recording], faulty: Sequence[Recording]) -> None:
    for kind, drives, before in (("healthy", healthy, ()), ("faulty", faulty, healthy)):
        check_each_once((*before, *drives))
        for recording in drives:
            told = recording.entry.get("fault", "")  # None: known to be healthy
            if told is None if kind == "faulty" else told:
                said = f"given as {kind}, its manifest says {told or 'healthy'}"
                raise UsageError(f"{recording.path}: {said}")


def _row(recording: Recording, judged: Judged) -> dict[str, Any]:
    """Return the verdicts of the monitor and of the paper's rule on a drive."""
    evidence = [window.response.evidence for window in judged.windows]
    return {
        "recording": recording.path.name,
        "sha256": recording.sha256,
        **{name: recording.entry.get(name) for name in ("source", "fault", "severity")},
        "windows": len(judged.windows),
        "paper_failed": sum(window.paper_failed for window in judged.windows),
        "codes": sorted({dtc.code for dtc in judged.dtcs}),
        "named": sorted({dtc.fault for dtc in judged.dtcs}),
        "completed": judged.completed,
        "evidence": max(evidence, default=None),
    }


def _warnings(card: ModelCard, good: Drives, bad: Drives, config: Config) -> list[str]:
    trained = {r.sha256 for r in card.recordings}
    texts = [
        f"{r.path}: the model was trained on it, so its residuals are smaller than on other drives"
        for r, _ in good
        if r.sha256 in trained
    ]
    for r, judged in (*good, *bad):
        if not judged.windows:
            why = [cause.in_words for cause in why_not(r, card, config)[:1]]
            texts.append("; ".join([f"{r.path}: no window, so it says nothing", *why]))
    speaking = sum(bool(judged.windows) for _, judged in good)
    if speaking < FEW_DRIVES:
        few = f"{counted(speaking, 'healthy drive')} with windows: how drives differ is hardly seen"
        texts.append(f"{few}, {FEW_DRIVES} and more are wanted")
    return texts
