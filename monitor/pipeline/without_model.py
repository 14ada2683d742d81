"""Tables without the model's signals: the tests that need no model judge them.

The electrical tests judge the wideband sensor where the log has its reading and the engine's speed;
the catalyst is judged where it has the voltage behind it.
"""

from typing import Any, Final

import numpy as np

from monitor.base.config import Config
from monitor.base.errors import CoarseTableError, MissingSignalsError
from monitor.base.signals import OUTPUT
from monitor.grid.table_samples import table_block
from monitor.grid.tables import Table
from monitor.judge.catalyst.watch import VOLTAGE
from monitor.judge.causes.causes import Cause
from monitor.judge.counters import Counters
from monitor.judge.electrical.plausibility import ENGINE
from monitor.judge.electrical.suite import ElectricalTests
from monitor.judge.enable import BURNING, Enable, holds, masks
from monitor.memory.dtc_store import DtcStore
from monitor.model.card import Channel
from monitor.pipeline.behind import CUT, judge_behind
from monitor.pipeline.collector import Trace
from monitor.pipeline.conclusions import frozen
from monitor.pipeline.entry import dtc_entry, not_judged

TESTS: Final = ("communication", "range", "ready", "activity")
PULSE: Final = "injector_pulse_width_ms"


def can_judge(table: Table, lacking: MissingSignalsError) -> bool:
    """Return whether some test can judge the table.

    lacking : why the model cannot judge it
    An own table that lacks a column is a mistake of its maker; a logger's file lacks what its car
    does not tell.
    """
    may_lack = bool(table.profile) or isinstance(lacking, CoarseTableError)
    return VOLTAGE in table.names or (may_lack and {OUTPUT, ENGINE} <= set(table.names))


def judge(
    table: Table, store: DtcStore, config: Config, lacking: MissingSignalsError
) -> dict[str, Any]:
    """Return the table's entry in ``o2mon.replay/1``, without its path and sha256.

    store : fault memory, in which a driving cycle has begun
    lacking : why the model cannot judge the table
    """
    causes: list[Cause] = []
    catalyst: dict[str, Any] = {}
    judged = []
    begin_ns = int(table.t_ns[0])
    store.judge_memory(begin_ns)
    if {OUTPUT, ENGINE} <= set(table.names):
        _judge_reading(table, store, config)
        advice = str(lacking).removeprefix(f"{table.path}: ")
        causes.append(Cause("response", None, None, "no_model", advice))
        judged.append("the electrical state of the sensor")
    if VOLTAGE in table.names:
        catalyst, why = judge_behind(table, store, config)
        causes += why
        judged.append("the catalyst")
    return {
        "samples": len(table.t_ns),
        "enabled_samples": 0,
        "windows": [],
        "windows_interrupted": 0,
        "windows_dropped": 0,
        "dtcs": [dtc_entry(dtc, begin_ns, 1.0) for dtc in store.active],
        "fault_flag": store.fault_flag,
        "completed": False,
        "not_judged": None if store.fault_flag else not_judged(causes),
        "evidence": {},
        "counters": {},
        **({"catalyst": catalyst} if catalyst else {}),
        "profile": table.profile,
        "notes": [*table.notes.lines, f"without a model only {' and '.join(judged)} is judged"],
    }


def series(table: Table) -> Trace:
    """Return the measured lambda for the report, nothing where the table has none."""
    if OUTPUT not in table.names:
        return Trace.unpredicted(np.empty(0), np.empty(0))
    t_s = (table.t_ns - table.t_ns[0]) / 1e9
    return Trace.unpredicted(t_s, table.values[:, table.names.index(OUTPUT)])


def _judge_reading(table: Table, store: DtcStore, config: Config) -> None:
    """Let the electrical tests judge the wideband sensor.

    A reading near lambda 1 is not judged: a controller holds the mixture there, and without a model
    nobody knows how long a coarse logger shows the same number. Nor does anything tell the lean end
    of the sensor's range, so where the log has no fuel cut, any lean reading may be that of one.
    """
    names = tuple(name for name in table.names if name != CUT or _tells_cut(table))
    block = table_block(table, names)
    period_s = float(np.median(np.diff(block.t_ns))) / 1e9 if len(block.t_ns) > 1 else 1.0
    lean = 1.0 + config.plausibility.stuck_band_at_one
    output = Channel(OUTPUT, "-", 0.0, lean, lean, lean)
    enable = Enable(config.enable, names, (), OUTPUT, period_s)
    tests = ElectricalTests(config, names, output, period_s)
    burning = holds(masks(enable.push(block.values, block.quality)), BURNING)
    found, *_ = tests.push(block.values, block.quality, burning)
    counters = Counters(TESTS, config, store)
    for k, result in found:
        if result.fault != "stuck_at_one":
            changes = counters.electrical(result, block.t_ns.item(k))
            list(frozen(changes, store, names, block.values[k]))


def _tells_cut(table: Table) -> bool:
    """Return whether a fuel cut is known; one made of a low manifold pressure is a guess."""
    return PULSE in table.names or table.columns.get(CUT, CUT).startswith("column")
