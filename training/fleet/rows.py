"""Rows of the two tables of a fleet, from the verdicts on one recording."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.base.types import Quality, SampleBlock
from monitor.judge.enable import CONDITIONS
from monitor.judge.findings import WindowJudged
from monitor.model.card import ModelCard
from training.fleet.columns import BEHIND_KEYS, COUNTERS, ESTIMATES, WHICH
from training.fleet.drives import FleetDrive
from training.fleet.reading import Read
from training.limits.judging import Judged
from training.recordings.start import start_of

Row = dict[str, Any]
OF_VERDICT = ("mean", "std", "paper_failed", "fault", "excited")


def failed_row(drive: FleetDrive, reason: str) -> Row:
    """Return the row of a recording that could not be judged, with the reason as its error."""
    return _which(drive) | {"error": reason}


def recording_row(
    drive: FleetDrive, read: Read, judged: Judged, card: ModelCard, known: int
) -> Row:
    """Return the row of a judged recording.

    known : number of earlier drives in the reference of the vehicle
    """
    period_s = card.period_ns * 1e-9
    windows = judged.windows
    outcomes, stds = [window.outcome for window in windows], [window.std for window in windows]
    last = windows[-1].statistics if windows else {}
    declared = drive.declared
    return {
        **_which(drive),
        "sha256": read.sha256,
        "size_bytes": read.size_bytes,
        "source": declared[1] if declared and declared[0] == read.sha256 else None,
        "start": start_of(read.begin_ns, drive.path),
        "samples": len(judged.enabled),
        "duration_s": len(judged.enabled) * period_s,
        "enabled_s": int(judged.enabled.sum()) * period_s,
        "windows": len(windows),
        "windows_interrupted": judged.interrupted_windows,
        **{f"windows_{k}": outcomes.count(k) for k in ("passed", "failed", "inconclusive")},
        "windows_excited": sum(window.excited for window in windows),
        "windows_paper_failed": sum(window.paper_failed for window in windows),
        "completed": judged.completed,
        "fault_flag": bool(judged.dtcs),
        "codes": [dtc.code for dtc in judged.dtcs],
        "faults": [dtc.fault for dtc in judged.dtcs],
        "states": [dtc.state for dtc in judged.dtcs],
        **_first_code(read.block, judged, period_s),
        "residual_mean": float(np.mean([w.mean for w in windows])) if windows else None,
        "residual_std": float(np.sqrt(np.mean(np.square(stds)))) if stds else None,
        **{name: last.get(name) for name in ("offset", "gain", *ESTIMATES)},
        **{name: _reached_twice(windows, name) for name in ("evidence", "offset_beyond")},
        "reference_drives": known,
        "offset_low": _finite(judged.limits.offset_low),
        "offset_high": _finite(judged.limits.offset_high),
        "reference_gain": judged.limits.gain,
        **{column: (judged.behind or {}).get(key) for column, key in BEHIND_KEYS.items()},
        **_quality(read, card),
        **_counters(read.counters),
        **{
            f"held_{name}": None if name in read.unavailable else float(share)
            for name, share in zip(CONDITIONS, judged.conditions.mean(axis=0), strict=True)
        },
    }


def window_rows(drive: FleetDrive, read: Read, judged: Judged) -> list[Row]:
    """Return one row per window of a judged recording."""
    which = _which(drive) | {"start": start_of(read.begin_ns, drive.path)}
    t0_ns = int(read.block.t_ns[0])
    return [
        {
            **which,
            "window": verdict.window.index,
            "t_start_s": (verdict.window.t_start_ns - t0_ns) / 1e9,
            "t_end_s": (verdict.window.t_end_ns - t0_ns) / 1e9,
            **{name: getattr(verdict, name) for name in OF_VERDICT},
            "verdict": verdict.outcome,
            "also": list(verdict.also),
            **verdict.statistics,
        }
        for verdict in judged.windows
    ]


def _which(drive: FleetDrive) -> Row:
    return {name: getattr(drive, name) for name in WHICH}


def _first_code(block: SampleBlock, judged: Judged, period_s: float) -> Row:
    """Return the time of the first code of this drive; codes of earlier drives do not count."""
    at_ns = min((d.t_ns for d in judged.dtcs if d.t_ns), default=None)
    if at_ns is None:
        return {"first_code_s": None, "first_code_enabled_s": None}
    k = int(np.searchsorted(block.t_ns, at_ns, side="right"))
    return {
        "first_code_s": (at_ns - int(block.t_ns[0])) / 1e9,
        "first_code_enabled_s": int(judged.enabled[:k].sum()) * period_s,
    }


def _reached_twice(windows: Sequence[WindowJudged], name: str) -> float | None:
    """Return the largest value of a statistic that two successive windows reach, if any do."""
    values = [w.statistics[name] for w in windows]
    x = np.array([-np.inf if v is None else v for v in values], dtype=np.float64)
    return _finite(float(np.minimum(x[1:], x[:-1]).max(initial=-np.inf)))


def _quality(read: Read, card: ModelCard) -> Row:
    """Return the numbers of samples with a bad signal of the model, by reason."""
    needed = [read.names.index(name) for name in (*card.input_names, card.output.name)]
    quality = read.block.quality[:, needed]
    kinds = Quality.STALE, Quality.INVALID, Quality.OUT_OF_RANGE
    return {f"samples_{q.name.lower()}": int((quality == q).any(axis=1).sum()) for q in kinds}


def _counters(counters: Mapping[str, int]) -> Row:
    """Return the counters of frames and values as columns of the table of recordings."""
    if not counters:
        return {}
    never = "never_received_"
    row: Row = {column: counters.get(name) for column, name in COUNTERS.items()}
    if row["values_out_of_range"] is None:  # a table has one counter per column
        row["values_out_of_range"] = sum(counters.values())
        return row
    names = [name.removeprefix(never) for name in counters if name.startswith(never)]
    return row | {"never_received": names}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
