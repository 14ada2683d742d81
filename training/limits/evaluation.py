"""Errors of a model on recordings, in free run and one step ahead, also on enabled samples."""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base import config
from monitor.base.config import Config
from monitor.base.counts import counted, plain
from monitor.base.errors import RecordingError, UsageError
from monitor.base.files.manifest import entry_of
from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from monitor.model.step import Model, from_model_units, to_model_units
from training.limits.judging import enabled_samples, judge_recordings
from training.limits.rates import rate
from training.limits.side_by_side import Judged
from training.recordings import metrics
from training.recordings.prediction import check_period
from training.recordings.recording import Recording, check_each_once
from training.recordings.samples.rows import runs

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
    to score; UsageError if ``washout`` is negative, or a drive given twice and ``healthy``;
    ModelError if ``healthy`` and the model has no decision limits.
    """
    model = Model.load(path)
    washout = model.card.lags if washout is None else washout
    if washout < 0:
        raise UsageError(f"washout {washout}: must not be negative")
    alarms: dict[str, Any] = {}
    if healthy:
        check_each_once(recordings)
        settings = config.load()
        limits = Limits.from_card(model.card, settings, str(model.path))
        judged = judge_recordings(recordings, model, limits, settings)
        found = false_alarms([*zip(recordings, judged, strict=True)], settings)
        alarms = {"false_alarms": found}
    return {
        "schema": SCHEMA,
        "model": str(path),
        "model_sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest(),
        "washout": washout,
        "unit": model.card.output.unit,
        "recordings": [_one(model, recording, washout) for recording in recordings],
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
        f"healthy drives with a code: {found['events']} of {found['trials']} (95 %: "
        f"{100 * found['low']:.1f} to {100 * found['high']:.1f} %); the limits state at "
        f"most {plain(100 * found['stated'], 2)} % of drives like those that set them, and "
        f"{counted(found['trials'], 'drive')} can prove {100 * found['provable']:.1f} % at best; "
        f"{found['completed']} decided by the response test{named}"
    )


def predict(
    model: Model, recording: Recording, washout: int
) -> tuple[FloatArray, FloatArray, FloatArray, np.ndarray]:
    """Return measured, free-run and one-step output (n,) and a mask of the scored rows (n,) bool.

    A stretch begins where all inputs and the output are valid and ends at an invalid input. The
    measured output is clipped to the range of the model (lambda at most 16).
    Raises RecordingError if the sample periods of recording and model differ.
    """
    card = model.card
    check_period(recording, card)
    u = np.stack([recording.column(name) for name in card.input_names], axis=1)
    y = recording.column(card.output.name)
    measured = from_model_units(card.transform, to_model_units(card.transform, y))
    both = model.with_batch(2)  # row 0 runs freely, row 1 is forced at every sample
    free, one_step = np.full(len(y), np.nan), np.full(len(y), np.nan)
    scored = np.zeros(len(y), dtype=bool)
    for first, stop in runs(np.asarray(np.isfinite(u).all(axis=1))):
        valid = np.flatnonzero(np.isfinite(y[first:stop]))
        if not len(valid):
            continue
        begin = first + int(valid[0])
        both.reset(u[begin], float(y[begin]))
        for t in range(begin, stop):
            free[t], one_step[t] = both.step_batch(u[t])
            both.force_output(np.array([y[t] if t < begin + washout else np.nan, y[t]]))
        scored[begin + washout : stop] = np.isfinite(y[begin + washout : stop])
    return measured, free, one_step, scored


def _one(model: Model, recording: Recording, washout: int) -> dict[str, Any]:
    measured, free, one_step, scored = predict(model, recording, washout)
    if not scored.any():
        raise RecordingError(
            f"{recording.path}: no sample can be scored, the inputs or "
            f"{model.card.output.name} are never valid for more than {washout} samples"
        )
    enabled = scored & enabled_samples(recording, model.card, config.load())
    return {
        "path": str(recording.path),
        "sha256": recording.sha256,
        "source": entry_of(Path(recording.path), recording.sha256).get("source"),
        **_figures(model, measured, free, one_step, scored),
        "enabled": _figures(model, measured, free, one_step, enabled) if enabled.any() else None,
    }


def _figures(
    model: Model, measured: FloatArray, free: FloatArray, one_step: FloatArray, rows: np.ndarray
) -> dict[str, Any]:
    a, b = measured[rows], free[rows]
    varies = len(a) > 1 and float(np.ptp(a)) > 1e-9 * max(1.0, float(np.abs(a).max()))
    figures: dict[str, Any] = {
        "samples": len(a),
        "rmse": metrics.rmse(a, b),
        "fit_percent": metrics.fit_percent(a, b) if varies else None,
        "correlation": metrics.correlation(a, b) if varies else None,
        "slope": metrics.slope(a, b) if varies else None,
        "one_step_rmse": metrics.rmse(a, one_step[rows]),
        "residual_mean": float((a - b).mean()),
        "residual_std": float((a - b).std()),
    }
    if model.card.transform == "phi":
        figures["rmse_phi"] = metrics.rmse(1.0 / a, 1.0 / b)
        figures["fit_percent_phi"] = metrics.fit_percent(1.0 / a, 1.0 / b) if varies else None
    return figures
