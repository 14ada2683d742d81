"""One simulated drive with a catalyst: its faults, its samples, and what the monitor says of it.

Names and samples are those of the simulated ECU's messages on the monitor's grid.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from monitor.base import downstream_faults, faults
from monitor.base.config import Config, DebounceConfig
from monitor.base.types import FloatArray
from monitor.judge.catalyst.watch import BehindResult, CatalystMonitor
from monitor.judge.decision.decisions import CIRCUIT_TESTS
from monitor.memory.codes import CODES
from monitor.memory.debounce import PASSED, Debounce
from training.dyno import downstream, ecu, effects
from training.dyno.simulation import Experiment, simulate
from training.dyno.vehicle import Conditions, conditions, piece

CYCLES: Final = ("wltc_3b", "udds", "micro_trips")
PERIOD_S: Final = 0.1
BIAS_LAMBDA: Final = 0.02  # of a faulty upstream sensor
STEPS_PHI: Final = 0.03  # of the ECU's active test
MODES: Final = ("passive", "cut", "active")
CATALYST: Final = "catalyst"  # name of its test
FOLLOWS: Final = "bias"  # a test whose code follows that of the balance


@dataclass(frozen=True, slots=True)
class Case:
    """A fault of catalyst, sensors, exhaust or metering; the vehicle's own parts otherwise."""

    name: str
    grams: float | None = None
    sensor: str = ""  # fault of the downstream sensor
    upstream: str = ""  # fault of the upstream sensor
    leak: float = 0.0
    sulphur: float = 0.0  # part of the capacity that it blocks at the start
    ethanol: float = 0.0  # percent
    bias_lambda: float = BIAS_LAMBDA
    sensor_severity: float | None = None
    mode: str = "cut"  # "passive": no fuel cut, "active": fuel cut and the ECU's own steps
    meter: float = 1.0  # factor on the air meter
    injector: float = 1.0  # factor on the injectors

    @property
    def offset_lambda(self) -> float:
        """Return the offset of a faulty upstream sensor, 0 without one."""
        return {"biased_lean": 1.0, "biased_rich": -1.0}.get(self.upstream, 0.0) * self.bias_lambda


def drive(
    vehicle: int,
    cycle: str,
    case: Case,
    duration_s: float,
    weather: Conditions | None = None,
    period_s: float = PERIOD_S,
) -> tuple[tuple[str, ...], FloatArray, float]:
    """Return names, samples (n, n_names) and true capacity in g of one drive.

    weather : by default what the vehicle's number draws
    """
    own = downstream.piece(vehicle).capacity_g
    outside = weather or conditions(vehicle)
    parts = piece(vehicle)
    parts = parts._replace(
        maf_gain=parts.maf_gain * case.meter, injector_gain=parts.injector_gain * case.injector
    )
    healthy = downstream_faults.DownstreamFault("", 0.0)
    fault = downstream_faults.resolve(case.sensor, case.sensor_severity) if case.sensor else healthy
    fault = replace(fault, capacity_g=case.grams or own)
    fault = replace(fault, leak=case.leak, sulphur=case.sulphur)
    signals = simulate(
        Experiment(
            cycle=cycle,
            vehicle=vehicle,
            seed=vehicle,
            duration_s=duration_s,
            downstream=True,
            downstream_fault=fault,
            fault=faults.resolve(case.upstream, case.bias_lambda) if case.upstream else None,
            effects=effects.from_severities({"ethanol": case.ethanol}),
            conditions=outside._replace(overrun_cut=float(case.mode != "passive")),
            piece=parts,
            active_steps_phi=STEPS_PHI if case.mode == "active" else 0.0,
        )
    )
    bus_map = ecu.own_bus()
    sent = ecu.broadcast(signals, bus_map, np.random.default_rng(vehicle))
    block = ecu.samples(sent, bus_map, round(period_s * 1e9))
    return ecu.names_of(sent, bus_map), block.values, case.grams or own


def judged(
    names: Sequence[str], values: FloatArray, settings: Config, period_s: float = PERIOD_S
) -> dict[str, Any]:
    """Return what the monitor says of a drive, as JSON values.

    ``faults`` : name that each test set; ``faults_s`` : when; ``passed_s`` : when each test first
    passed; ``decided`` and ``decided_s`` : the first decision on the catalyst
    """
    monitor = CatalystMonitor(settings.catalyst, names, period_s)
    running = np.ones(len(values), dtype=np.bool_)
    found = settled(monitor.push(values, running), settings.debounce, period_s)
    sides = (("failed", found["faults_s"]), ("passed", found["passed_s"]))
    times = [(own[CATALYST], side) for side, own in sides if CATALYST in own]
    decided_s, decided = min(times, default=(None, None))
    return (monitor.entry() or {}) | found | {"decided": decided, "decided_s": decided_s}


def settled(
    results: Iterable[BehindResult], debounce: DebounceConfig, period_s: float
) -> dict[str, Any]:
    """Return names and times of the tests' decisions, debounced as the fault memory does."""
    counters: dict[str, Debounce] = {}
    named: dict[str, str] = {}
    faults_s: dict[str, float] = {}
    passed_s: dict[str, float] = {}
    for test, claim, at in ((r.test, r.claim, r.at) for r in results):
        if claim.outcome == "inconclusive" or test == FOLLOWS:
            continue
        failed, t_s = claim.outcome == "failed", round(at * period_s, 3)
        by = debounce.response_fail if failed else debounce.response_pass
        at_once = test in CIRCUIT_TESTS
        before = counters.get(test, Debounce())
        after = before.step(failed=failed, by=-PASSED if at_once else by)
        counters[test] = after
        if after.passed:
            passed_s.setdefault(test, t_s)
        elif after.failed and claim.fault:
            faults_s.setdefault(test, t_s)
            known = named.setdefault(test, claim.fault)
            if CODES[known] == CODES[claim.fault]:
                named[test] = claim.fault
    return {"faults": named, "faults_s": faults_s, "passed_s": passed_s}
