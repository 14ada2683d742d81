"""Errors of a model on recordings, in free run and one step ahead, also on enabled samples."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monitor.base import config
from monitor.base.config import Config
from monitor.base.counts import counted, plain
from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import BoolArray
from monitor.judge.limits import Limits
from monitor.model.step import Model
from training.limits.judging import Judged, checked, judge_recordings
from training.limits.rates import in_words, rate
from training.recordings import metrics
from training.recordings.prediction import predict
from training.recordings.recording import Recording, check_each_once

SCHEMA = "o2train.evaluate/1"


def evaluate(
    path: Path | str,
    recordings: Sequence[Recording],
    washout: int | None = None,
    *,
    healthy: bool = False,
) -> dict[str, Any]:
    """Return the figures of the model file on ``recordings``, in the output's unit.

    washout : number of samples at the start of every unbroken stretch; they set the state from the
        measured output and are not scored; default: the longest lag
    healthy : the sensors were sound: ``false_alarms`` says how many drives have a code, beside the
        rate that the card's limits promise for drives like those that set them
    Raises RecordingError if a recording lacks a signal, has another sample period or has no sample
    to score; UsageError if ``washout`` is negative, or there is no drive or one twice; ModelError
    if ``healthy`` and the model has no decision limits.
    """
    model = Model.load(path)
    washout = model.card.lags if washout is None else washout
    if washout < 0:
        raise UsageError(f"washout {washout}: must not be negative")
    check_each_once(recordings)
    settings, alarms = config.load(), dict[str, Any]()
    if healthy:
        limits = Limits.from_card(model.card, settings, str(model.path))
        judged = judge_recordings(recordings, model, limits, settings)
        alarms["false_alarms"] = false_alarms([*zip(recordings, judged, strict=True)], settings)
    return {
        "schema": SCHEMA,
        "model": str(path),
        "model_sha256": model.sha256,
        "washout": washout,
        "unit": model.card.output.unit,
        "recordings": [_one(model, recording, washout, settings) for recording in recordings],
        **alarms,
    }


def false_alarms(drives: Sequence[tuple[Recording, Judged]], settings: Config) -> dict[str, Any]:
    """Return the stated and the observed rate of healthy drives with a code, per drive.

    Of n drives in which nothing was found, a further one is the worst with a probability of
    1/(n + 1), so they alone prove no smaller rate (``provable``).
    """
    named = {str(r.path): sorted({dtc.fault for dtc in own.dtcs}) for r, own in drives if own.dtcs}
    return {
        **rate(len(named), len(drives)),
        "stated": math.exp(-settings.response.evidence_fail),
        "provable": 1.0 / (len(drives) + 1.0),
        "completed": sum(own.completed for _, own in drives),
        "named": named,
    }


def alarms_in_words(found: dict[str, Any]) -> str:
    """Return what ``false_alarms`` found in words."""
    named = "".join(f"; {path}: {', '.join(each)}" for path, each in found["named"].items())
    return (
        f"healthy drives with a code: {in_words(found)}; the limits state at "
        f"most {plain(100 * found['stated'], 2)} % of drives like those that set them, and "
        f"{counted(found['trials'], 'drive')} can prove {100 * found['provable']:.1f} % at best; "
        f"{found['completed']} decided by the response test{named}"
    )


def _one(model: Model, recording: Recording, washout: int, settings: Config) -> dict[str, Any]:
    measured, free, one_step, scored = predict(model, recording, washout)
    if not scored.any():
        raise RecordingError(
            f"{recording.path}: no sample can be scored, the inputs or "
            f"{model.card.output.name} are never valid for more than {washout} samples"
        )

    def figures(rows: BoolArray) -> dict[str, Any]:
        a, b = measured[rows], free[rows]
        found = metrics.measures(a, b) | {"one_step_rmse": metrics.rmse(a, one_step[rows])}
        if model.card.transform != "phi":
            return found
        in_phi = metrics.measures(1.0 / a, 1.0 / b)
        return found | {f"{name}_phi": in_phi[name] for name in ("rmse", "fit_percent")}

    *_, held = checked(recording, model.card, settings)
    enabled = scored & held.all(axis=1)
    return {
        "path": str(recording.path),
        "sha256": recording.sha256,
        "source": recording.entry.get("source"),
        **figures(scored),
        "enabled": figures(enabled) if enabled.any() else None,
    }
