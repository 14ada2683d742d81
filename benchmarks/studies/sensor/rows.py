"""Rows of the detection matrix, one for every trial."""

from typing import Any

import numpy as np

from benchmarks.studies.rules.alarms import drive_scores, own_scores
from benchmarks.studies.rules.windows import Rule
from benchmarks.studies.sensor.plan import Trial
from monitor.base.types import SampleBlock
from monitor.judge.enable import CONDITIONS
from monitor.pipeline.side_by_side import Judged

Row = dict[str, Any]


def row(trial: Trial, block: SampleBlock, judged: Judged, rules: dict[str, Rule]) -> Row:
    """Return the answers of the monitor and the literature's rules to a trial, as JSON values."""
    period_s = float(np.diff(block.t_ns[:2])[0]) / 1e9
    enabled_s = np.cumsum(judged.enabled) * period_s
    windows = judged.windows

    def times_s(t_ns: int) -> tuple[float, float]:
        """Return the seconds of driving and of enabled driving up to ``t_ns``."""
        k = int(np.searchsorted(block.t_ns, t_ns, side="right")) - 1
        return round((t_ns - int(block.t_ns[0])) / 1e9, 3), round(float(enabled_s[k]), 3)

    first = min((d.t_ns for d in judged.dtcs), default=None)
    driving, enabled = (None, None) if first is None else times_s(first)
    scored = drive_scores(windows, rules)
    return trial.as_row() | {
        "completed": judged.completed,
        "codes": [d.code for d in judged.dtcs],
        "faults": sorted({d.fault for d in judged.dtcs}),
        "also": sorted({name for d in judged.dtcs for name in d.also}),
        "states": [d.state for d in judged.dtcs],
        "first_code_driving_s": driving,
        "first_code_enabled_s": enabled,
        "driving_s": round(len(block.t_ns) * period_s, 3),
        "enabled_s": round(float(enabled_s[-1]), 3),
        "windows": len(windows),
        "inconclusive": sum(w.outcome == "inconclusive" for w in windows),
        "not_held": {
            name: round(float(share), 5)
            for name, share in zip(CONDITIONS, 1.0 - judged.conditions.mean(axis=0), strict=True)
        },
        "scores": own_scores(windows) | {name: s.score for name, s in scored.items()},
        "alarms_enabled_s": {
            name: None if s.alarm is None else times_s(windows[s.alarm].window.t_end_ns)[1]
            for name, s in scored.items()
        },
        "failed_windows": {"monitor": sum(w.outcome == "failed" for w in windows)}
        | {name: s.failed for name, s in scored.items()},
    }
