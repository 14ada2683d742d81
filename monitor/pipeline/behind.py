"""The catalyst in a table without the model's signals, judged by how the rear sensor moves."""

from typing import Any, Final

import numpy as np

from monitor.base.config import CatalystConfig
from monitor.base.counts import counted
from monitor.base.types import FloatArray
from monitor.grid.tables import Table
from monitor.judge.catalyst.rear_activity import RearActivity
from monitor.judge.catalyst.watch import VOLTAGE
from monitor.judge.causes.causes import Cause
from monitor.memory.codes import codes_on
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.pipeline.entry import seconds

FRONT: Final = "upstream_voltage_v"  # of a front sensor that only switches


def judge_behind(
    table: Table, store: DtcStore, config: CatalystConfig
) -> tuple[dict[str, Any], list[Cause]]:
    """Return the entry of the catalyst, and why it was not judged, nothing if it was.

    store : fault memory, in which a driving cycle has begun
    """
    activity = RearActivity(config)
    if FRONT in table.names:
        _follow(table, activity, store, config)
    claim = activity.claim()
    entry = {
        "method": "activity",
        "trials": activity.trials,
        "followed": activity.followed,
        "verdict": claim.outcome,
        "log_odds": round(claim.log_odds, 3),
        "needed": round(activity.evidence_fail, 3),
    }
    return entry, [] if claim.outcome != "inconclusive" else [_cause(table, activity)]


def _follow(table: Table, activity: RearActivity, store: DtcStore, config: CatalystConfig) -> None:
    """Take all samples; the fault memory takes the first verdict, and another that follows."""
    front, rear = _column(table, FRONT), _column(table, VOLTAGE)
    cut = _column(table, "fuel_cut") if "fuel_cut" in table.names else np.zeros(len(front))
    before = "inconclusive"
    for k, t_ns in enumerate(table.t_ns.tolist()):
        burning = not cut[k] > 0.0
        if not activity.push(t_ns / 1e9, front[k], rear[k], burning=burning):
            continue
        claim = activity.claim()
        if claim.outcome == before:
            continue
        before = claim.outcome
        if claim.outcome == "failed" and claim.fault is not None:
            codes = codes_on(claim.fault, close_coupled=config.close_coupled)
            for dtc in store.fail(claim.fault, t_ns, codes=codes):
                read = zip(table.names, table.values[k].tolist(), strict=True)
                signals = {name: value for name, value in read if np.isfinite(value)}
                store.freeze(FreezeFrame(dtc.code, t_ns, signals))
            store.count_judged("catalyst")
        elif claim.outcome == "passed":
            store.complete("catalyst")
            store.count_judged("catalyst")


def _cause(table: Table, activity: RearActivity) -> Cause:
    """Return why the catalyst was not judged."""
    if FRONT not in table.names:
        missing = next(n for n in ("lambda_measured", "maf_kg_h", FRONT) if n not in table.names)
        advice = f"the capacity needs upstream lambda and the air flow: record {missing}, too"
        return _because(missing, "signal_missing", advice)
    step_s = seconds(int(np.median(np.diff(table.t_ns))), 0) if len(table.t_ns) > 1 else 0.0
    if not activity.trials:
        advice = f"one sample each {step_s:.2g} s, wanted two a second: log fewer signals"
        return _because(VOLTAGE, "too_slow", advice)
    advice = f"the front sensor switched {counted(activity.trials, 'time')}: record a longer drive"
    return _because(VOLTAGE, "undecided", advice)


def _because(signal: str, reason: str, advice: str) -> Cause:
    return Cause("catalyst", None, signal, reason, advice)


def _column(table: Table, name: str) -> FloatArray:
    return np.asarray(table.values[:, table.names.index(name)])
