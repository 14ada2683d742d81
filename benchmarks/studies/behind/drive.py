"""One drive with a catalyst: its samples, and what the monitor says of it.

Names and samples are those of the simulated ECU's messages on the monitor's grid.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmarks.studies.behind.plan import CatalystTrial
from benchmarks.studies.second import brick
from benchmarks.studies.sensor.conditions import weather
from monitor.base import faults
from monitor.base.config import Config, DebounceConfig
from monitor.base.types import FloatArray
from monitor.judge.catalyst.watch import BehindResult, CatalystMonitor
from monitor.judge.decision.decisions import CIRCUIT_TESTS
from monitor.memory.codes import CODES
from monitor.memory.debounce import PASSED, Debounce
from training.dyno import downstream, ecu, effects
from training.dyno.downstream import DownstreamFault, fault_behind
from training.dyno.simulation import Experiment, simulate
from training.dyno.vehicle import conditions, piece

PERIOD_S: Final = 0.1
STEPS_PHI: Final = 0.03  # of the ECU's active test
CATALYST: Final = "catalyst"  # name of its test
FOLLOWS: Final = "bias"  # a test whose code follows that of the balance


def drive(trial: CatalystTrial, seconds: float) -> tuple[tuple[str, ...], FloatArray, float]:
    """Return names, samples (n, n_names) and true capacity in g of a drive."""
    if trial.kind == "second":
        grams = trial.grams or 0.0
        own = brick.brick(trial.vehicle, grams)._replace(leak=trial.leak)
        values = brick.drive(trial.vehicle, trial.vehicle, own, trial.lag_s, trial.bias_lambda)
        return brick.NAMES, values[: round(seconds / PERIOD_S)], grams
    vehicle = trial.vehicle
    capacity_g = trial.grams or downstream.piece(vehicle).capacity_g
    outside = weather(trial.ambient, vehicle) if trial.ambient else conditions(vehicle)
    parts = piece(vehicle)
    fault = DownstreamFault("", 0.0)
    if trial.sensor:
        fault = fault_behind(trial.sensor, trial.lag_s)
    upstream = faults.resolve(trial.upstream, abs(trial.bias_lambda)) if trial.upstream else None
    signals = simulate(
        Experiment(
            cycle=trial.cycle,
            vehicle=vehicle,
            seed=vehicle,
            duration_s=seconds,
            downstream=True,
            downstream_fault=replace(fault, capacity_g=capacity_g, leak=trial.leak),
            fault=upstream,
            effects=effects.from_severities({"ethanol": trial.ethanol}),
            conditions=outside._replace(overrun_cut=float(trial.mode != "passive")),
            piece=parts._replace(
                maf_gain=parts.maf_gain * trial.meter,
                injector_gain=parts.injector_gain * trial.injector,
            ),
            active_steps_phi=STEPS_PHI if trial.mode == "active" else 0.0,
        )
    )
    bus_map = ecu.own_bus()
    sent = ecu.broadcast(signals, bus_map, np.random.default_rng(vehicle))
    block = ecu.samples(sent, bus_map, round(PERIOD_S * 1e9))
    return ecu.names_of(sent, bus_map), block.values, capacity_g


def judged(names: Sequence[str], values: FloatArray, settings: Config) -> dict[str, Any]:
    """Return what the monitor says of a drive, as JSON values.

    ``faults`` : name that each test set; ``faults_s`` : when; ``passed_s`` : when each test first
    passed; ``decided`` and ``decided_s`` : the first decision on the catalyst
    """
    monitor = CatalystMonitor(settings, names, PERIOD_S)
    running = np.ones(len(values), dtype=np.bool_)
    found = settled(monitor.push(values, running), settings.debounce)
    sides = (("failed", found["faults_s"]), ("passed", found["passed_s"]))
    times = [(own[CATALYST], side) for side, own in sides if CATALYST in own]
    decided_s, decided = min(times, default=(None, None))
    return (monitor.entry() or {}) | found | {"decided": decided, "decided_s": decided_s}


def settled(results: Iterable[BehindResult], debounce: DebounceConfig) -> dict[str, Any]:
    """Return names and times of the tests' decisions, debounced as the fault memory does."""
    counters: dict[str, Debounce] = {}
    named: dict[str, str] = {}
    faults_s: dict[str, float] = {}
    passed_s: dict[str, float] = {}
    for test, claim, at in ((r.test, r.claim, r.at) for r in results):
        if claim.outcome == "inconclusive" or test == FOLLOWS:
            continue
        failed, t_s = claim.outcome == "failed", round(at * PERIOD_S, 3)
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
