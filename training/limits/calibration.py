"""Decision limits of a model from healthy drives and drives with sensors at the limit severity.

Calibration sets all limits of the model card. The paper's two limits keep a chosen false-alarm
rate within its bounds. All other limits follow the rules of ``decision_limits``.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.config import Config
from monitor.base.counts import counted
from monitor.base.errors import ConfigError, RecordingError, UsageError
from monitor.base.files import manifest
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.model.card import Limit, ModelCard
from monitor.model.step import Model
from monitor.pipeline.events import WindowJudged
from training.limits.decision_limits import limits_of
from training.limits.judging import Judged, judge_recordings, most_common_cause, why_not
from training.limits.paper_limits import PaperLimits, Residuals, choose, held_out
from training.limits.response.response_limits import response_limits
from training.limits.tolerance import CONFIDENCE, rate_bounds
from training.limits.trust import trust_of
from training.recordings.recording import Recording, check_each_once, sha256

SCHEMA = "o2train.calibrate/1"
FEW_DRIVES = 5  # with fewer drives, drawing whole drives shows little of their spread

Drives = list[list[WindowJudged]]


def calibrate(
    path: Path,
    healthy: Sequence[Recording],
    faulty: Sequence[Recording],
    rate: float,
    config: Config,
) -> tuple[ModelCard, dict[str, Any]]:
    """Return the model card with new limits, and the figures of the report as JSON values.

    The function writes no file.

    path : model file
    faulty : recordings with a sensor fault at the limit severity; may be empty
    rate : false alarms of the paper's rule per healthy window, above 0 and below 0.5
    Raises RecordingError if there are too few healthy windows, UsageError for an impossible rate or
    a recording whose manifest contradicts its role, ConfigError if model and configuration differ
    in the window length.
    """
    if not 0.0 < rate < 0.5:
        raise UsageError(f"--false-alarms {rate:g}: wanted more than 0 and less than 0.5")
    _check(healthy, faulty)
    model = Model.load(path)
    if model.card.window_samples != config.window.n_samples:
        raise ConfigError(
            f"{path}: its limits are for windows of {model.card.window_samples} samples, "
            f"[window] n_samples is {config.window.n_samples}"
        )
    judged, judged_bad = (
        judge_recordings(drives, model, NO_LIMITS, config) for drives in (healthy, faulty)
    )
    good, bad = ([each.windows for each in drives] for drives in (judged, judged_bad))
    seen, seen_bad = _residuals(good), _residuals(bad) if any(bad) else None
    try:
        chosen = choose(seen, seen_bad, rate)
    except RecordingError as error:
        cause = most_common_cause(healthy, model.card, config)
        raise RecordingError(f"{error}; {cause}" if cause else str(error)) from None
    alarms, detected = held_out(seen, seen_bad, rate)
    card = _with_limits(
        model.card, healthy, good=good, bad=bad, chosen=chosen, rate=rate, config=config
    )
    limits = Limits.from_card(card, config, str(path))
    response = response_limits(model, healthy, limits, config)
    card = replace(card, limits={**card.limits, **response})
    card = replace(card, trust=trust_of([(model, healthy)], card, config, str(path)))
    limits = Limits.from_card(card, config, str(path))
    healthy_rows = _rows(healthy, good, model, limits, config)
    faulty_rows = _rows(faulty, bad, model, limits, config)
    return card, {
        "schema": SCHEMA,
        "model": path.name,
        "model_sha256": sha256(path),
        "false_alarms_wanted": rate,
        "confidence": CONFIDENCE,
        "simulated": any(_entry(r).get("source") == "simulated" for r in (*healthy, *faulty)),
        "limits": [_changed(name, card, model.card) for name in card.limits],
        "false_alarms": _false_alarms(chosen, len(healthy)) | {"held_out": alarms},
        "healthy": healthy_rows,
        "faulty": faulty_rows,
        "monitor": {"healthy": _codes(healthy_rows), "faulty": _codes(faulty_rows)},
        "detection": _detection(bad, limits, detected),
        "warnings": _warnings(
            model.card, healthy, good=good, faulty=faulty, bad=bad, config=config
        ),
    }


def _check(healthy: Sequence[Recording], faulty: Sequence[Recording]) -> None:
    for kind, drives, before in (("healthy", healthy, ()), ("faulty", faulty, healthy)):
        check_each_once((*before, *drives))
        for recording in drives:
            entry = _entry(recording)
            fault = entry.get("fault")
            if kind == "healthy" and fault:
                raise UsageError(f"{recording.path}: given as healthy, its manifest says {fault}")
            if kind == "faulty" and entry and not fault:
                raise UsageError(f"{recording.path}: given as faulty, its manifest says healthy")


def _entry(recording: Recording) -> dict[str, Any]:
    """Return the manifest entry of a recording, {} without an entry for this file content."""
    entry = manifest.load(Path(recording.path).parent).get(Path(recording.path).name, {})
    return entry if entry.get("sha256") == recording.sha256 else {}


def _residuals(drives: Drives) -> Residuals:
    return Residuals(
        np.array([w.mean for windows in drives for w in windows]),
        np.array([w.std for windows in drives for w in windows]),
        np.repeat(np.arange(len(drives)), [len(windows) for windows in drives]),
    )


def _with_limits(
    card: ModelCard,
    healthy: Sequence[Recording],
    good: Drives,
    bad: Drives,
    chosen: PaperLimits,
    rate: float,
    config: Config,
) -> ModelCard:
    origin = f"o2train calibrate, {counted(len(good), 'healthy drive')}"
    limits = limits_of(good, card, config, origin, healthy)
    n_bad = sum(map(len, bad))
    how = (
        f"misses the fewest of {n_bad} windows of {counted(len(bad), 'limit-fault drive')}"
        if n_bad
        else "each limit alone keeps the rate"
    )
    origin = (
        f"o2train calibrate: at most {rate:g} false alarms per window, {how}; "
        f"{chosen.alarms} of {chosen.windows} healthy windows of "
        f"{counted(len(good), 'drive')} alarm, rate at most {chosen.bound:.3g} with "
        f"{100 * CONFIDENCE:g} % confidence if windows are independent, "
        + (
            f"{chosen.bound_drives:.3g} drawing whole drives"
            if chosen.alarms
            else "which alone bounds it without an alarm"
        )
    )
    paper = {"j_mu": chosen.j_mu, "j_sigma": chosen.j_sigma}
    for name, value in paper.items():
        limits[name] = Limit(value, card.output.unit, origin)
    return replace(card, limits={**card.limits, **limits})


def _changed(name: str, card: ModelCard, old: ModelCard) -> dict[str, Any]:
    limit, before = card.limits[name], old.limits.get(name)
    return {
        "name": name,
        "value": limit.value,
        "before": before.value if before else None,
        "unit": limit.unit,
        "origin": limit.origin,
    }


def _false_alarms(chosen: PaperLimits, n_drives: int) -> dict[str, Any]:
    return {
        "alarms": chosen.alarms,
        "windows": chosen.windows,
        "drives": n_drives,
        "bound": chosen.bound,
        "bound_confidence": chosen.confidence,
        "bound_drives": chosen.bound_drives,
    }


def _rows(
    recordings: Sequence[Recording], drives: Drives, model: Model, limits: Limits, config: Config
) -> list[dict[str, Any]]:
    """Return the verdicts of the paper's rule and of the monitor on each drive, new limits."""
    judged = judge_recordings(recordings, model, limits, config)
    return [_row(*drive, limits) for drive in zip(recordings, drives, judged, strict=True)]


def _row(
    recording: Recording, windows: list[WindowJudged], judged: Judged, limits: Limits
) -> dict[str, Any]:
    entry = _entry(recording)
    seen = _residuals([windows])
    failed = int(seen.failed(limits.j_mu, limits.j_sigma).sum())
    low, high = rate_bounds(failed, len(windows)) if windows else (0.0, 1.0)
    return {
        "recording": Path(recording.path).name,
        "sha256": recording.sha256,
        "source": entry.get("source"),
        "fault": entry.get("fault"),
        "severity": entry.get("severity"),
        "windows": len(windows),
        "paper_failed": failed,
        "share": failed / len(windows) if windows else None,
        "share_low": low,
        "share_high": high,
        "codes": sorted({dtc.code for dtc in judged.dtcs}),
        "named": sorted({dtc.fault for dtc in judged.dtcs}),
        "completed": judged.completed,
        "evidence": max((_evidence(w) for w in judged.windows), default=None),
        "mean": [_short(x) for x in seen.mean],
        "std": [_short(x) for x in seen.std],
    }


def _evidence(window: WindowJudged) -> float:
    """Return the log likelihood of the likeliest fault over the likeliest sound sensor."""
    return window.statistics.response.evidence


def _codes(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the number of drives with a code, bounds of their share, and the largest evidence."""
    n, coded = len(rows), sum(bool(row["codes"]) for row in rows)
    low, high = rate_bounds(coded, n) if n else (0.0, 1.0)
    seen = [row["evidence"] for row in rows if row["evidence"] is not None]
    return {
        "drives": n,
        "with_code": coded,
        "named": sum(row["named"] == [row["fault"]] for row in rows),
        "low": low,
        "high": high,
        "largest_evidence": max(seen, default=None),
    }


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def _detection(bad: Drives, limits: Limits, detected: int | None) -> dict[str, Any] | None:
    """Return the detection rate of the paper's rule over all faulty windows, None without any.

    detected : number of faulty windows that fail limits set without their drive
    """
    seen = _residuals(bad)
    n = len(seen.mean)
    if n == 0:
        return None
    failed = int(seen.failed(limits.j_mu, limits.j_sigma).sum())
    low, high = rate_bounds(failed, n)
    shares = {"failed": failed, "share": failed / n, "low": low, "high": high}
    return {"windows": n, **shares, "held_out": detected}


def _warnings(
    card: ModelCard,
    healthy: Sequence[Recording],
    good: Drives,
    faulty: Sequence[Recording],
    bad: Drives,
    config: Config,
) -> list[str]:
    trained = {r.sha256 for r in card.recordings}
    texts = [
        f"{r.path}: the model was trained on it, so its residuals are smaller than on other drives"
        for r in healthy
        if r.sha256 in trained
    ]
    texts += [
        f"{r.path}: no window, so it says nothing{_why(r, card, config)}"
        for r, windows in zip((*healthy, *faulty), (*good, *bad), strict=True)
        if not windows
    ]
    speaking = sum(bool(windows) for windows in good)
    if speaking < FEW_DRIVES:
        texts.append(
            f"{counted(speaking, 'healthy drive')} with windows: how drives differ is hardly seen, "
            f"{FEW_DRIVES} and more are wanted"
        )
    return texts


def _why(recording: Recording, card: ModelCard, config: Config) -> str:
    found = why_not(recording, card, config)
    return f"; {found[0].in_words}" if found else ""
