"""The catalyst in a table without the model's signals, judged by how the rear sensor moves."""

import math
from typing import Any, Final

import numpy as np

from monitor.base.config import Config
from monitor.base.counts import counted, plain
from monitor.base.signals import OUTPUT
from monitor.base.types import FloatArray
from monitor.grid.table_samples import table_block
from monitor.grid.tables import Table
from monitor.judge.catalyst.bank import MID_V
from monitor.judge.catalyst.rear_activity import RearActivity
from monitor.judge.catalyst.rear_circuit import CIRCUIT, RearCircuit
from monitor.judge.catalyst.watch import VOLTAGE
from monitor.judge.causes.causes import Cause
from monitor.judge.counters import Counters
from monitor.judge.electrical.plausibility import ENGINE
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.conclusions import frozen
from monitor.pipeline.entry import seconds

CATALYST_TEST: Final = "catalyst"
CUT: Final = "fuel_cut"
FRONT: Final = "upstream_voltage_v"  # of a front sensor that only switches


def judge_behind(
    table: Table, store: DtcStore, config: Config
) -> tuple[dict[str, Any], list[Cause]]:
    """Return the entry of the catalyst, and why it was not judged, nothing if it was.

    store : fault memory, in which a driving cycle has begun
    """
    activity = RearActivity(config)
    _judge_circuit(table, store, config)
    if FRONT in table.names:
        _follow(table, activity, store, config)
    claim = activity.claim()
    entry = {
        "method": "activity",
        "trials": activity.trials,
        "followed": activity.followed,
        "verdict": claim.outcome,
        "log_odds": round(claim.log_odds, 3),
        "needed": round(config.response.evidence_fail, 3),
    }
    return entry, [] if claim.outcome != "inconclusive" else [_cause(table, activity)]


def _judge_circuit(table: Table, store: DtcStore, config: Config) -> None:
    """Let the circuit test judge the voltage; without a sign of lean gas all gas may be lean.

    Without the air flow nothing tells of a voltage at rest: a logger may repeat it.
    """
    wanted = (VOLTAGE, FRONT, OUTPUT, CUT, ENGINE)
    block = table_block(table, [name for name in wanted if name in table.names])
    at = {name: block.values[:, i] for i, name in enumerate(n for n in wanted if n in table.names)}
    n = len(block.t_ns)
    if OUTPUT in at:
        x = 1.0 - 1.0 / at[OUTPUT]
    elif FRONT in at:
        x = np.where(at[FRONT] < MID_V, 1.0, 0.0)
    else:
        x = np.ones(n)
    if CUT in at:
        x = np.where(at[CUT] > 0.0, 1.0, x)
    runs = np.ones(n, dtype=np.bool_)
    if ENGINE in at:
        runs = at[ENGINE] >= config.plausibility.engine_running_rpm
    period_s = float(np.median(np.diff(block.t_ns))) / 1e9 if n > 1 else 1.0
    circuit, counters = RearCircuit(config, period_s), Counters((CIRCUIT,), config, store)
    running = (np.cumsum(runs) * runs).tolist()
    for k, sample in enumerate(zip(at[VOLTAGE].tolist(), x.tolist(), running, strict=True)):
        volts, lean, run = sample
        for test, found in circuit.push(
            volts=volts, x=lean, air_g_s=0.0, running=run, duty_percent=math.nan
        ):
            changes = counters.take(test, found, block.t_ns.item(k), at_once=True)
            list(frozen(changes, store, list(at), block.values[k]))


def _follow(table: Table, activity: RearActivity, store: DtcStore, config: Config) -> None:
    """Take all samples; the fault memory takes the first verdict, and another that follows."""
    front, rear = _column(table, FRONT), _column(table, VOLTAGE)
    cut = _column(table, CUT) if CUT in table.names else np.zeros(len(front))
    counters, before = Counters((CATALYST_TEST,), config, store), "inconclusive"
    for k, t_ns in enumerate(table.t_ns.tolist()):
        burning = not cut[k] > 0.0
        if not activity.push(t_ns / 1e9, front[k], rear[k], burning=burning):
            continue
        claim = activity.claim()
        if claim.outcome in (before, "inconclusive"):
            continue
        before = claim.outcome
        changes = counters.take(CATALYST_TEST, claim, t_ns, at_once=True)
        list(frozen(changes, store, table.names, table.values[k]))


def _cause(table: Table, activity: RearActivity) -> Cause:
    """Return why the catalyst was not judged."""
    signal, reason = VOLTAGE, "undecided"
    step_s = seconds(int(np.median(np.diff(table.t_ns))), 0) if len(table.t_ns) > 1 else 0.0
    excursions = counted(activity.trials, "excursion")
    if FRONT not in table.names:
        signal = next(n for n in ("lambda_measured", "maf_kg_h", FRONT) if n not in table.names)
        reason = "signal_missing"
        advice = f"the capacity needs upstream lambda and the air flow: record {signal}, too"
    elif not activity.trials:
        reason = "too_slow"
        advice = f"one sample each {plain(step_s, 2)} s, wanted two a second: log fewer signals"
    elif not activity.shows_both_sides:
        advice = "the rear sensor stood on one side only: drive with fuel cuts or check its wiring"
    else:
        advice = f"{excursions} of the front sensor could be judged: record a longer drive"
    return Cause("catalyst", None, signal, reason, advice)


def _column(table: Table, name: str) -> FloatArray:
    return np.asarray(table.values[:, table.names.index(name)])
