"""Recordings of a case: simulated drives, decoded from the simulated vehicle's bus."""

import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.studies.workflow.plan import Case, Part
from monitor.base.faults import resolve
from monitor.decode.bus_map import BusMap
from training.dyno.ecu import broadcast, own_bus, samples
from training.dyno.effects import from_severities
from training.dyno.simulation import Experiment, simulate
from training.recordings.recording import Recording

PERIOD_NS: Final = 100_000_000


def recordings(case: Case, duration_s: float, *, hidden: bool = True) -> list[Recording]:
    """Return the case's recordings.

    duration_s : length of every recording
    hidden : False leaves out the hidden effects and the fault; the drives stay the same
    """
    effects = dict(case.hidden) if hidden else {}
    fault = case.fault if hidden else None
    return [recording(p, case.vehicle, duration_s, effects, fault) for p in case.parts]


def healthy(parts: Sequence[Part], vehicle: int, duration_s: float) -> list[Recording]:
    """Return the vehicle's recordings without a hidden effect or fault."""
    return [recording(p, vehicle, duration_s, {}, None) for p in parts]


def recording(
    part: Part,
    vehicle: int,
    duration_s: float,
    effects: Mapping[str, float],
    fault: tuple[str, float] | None,
) -> Recording:
    """Return one recording on the monitor's sample grid, with the bus's quantisation and timing.

    effects : name → severity; severity 1 moves lambda by about the plant's noise
    fault : name and severity; None or a part without ``fault_start_s`` means a healthy sensor
    """
    fails = resolve(*fault) if fault and part.fault_start_s is not None else None
    experiment = Experiment(
        cycle=part.cycle,
        vehicle=vehicle,
        seed=part.seed,
        fault=fails,
        fault_start_s=part.fault_start_s or 0.0,
        effects=from_severities(effects),
        duration_s=part.start_s + duration_s,
    )
    bus = _bus()
    rng = np.random.default_rng([0x0_2, 24, part.seed])
    sent = broadcast(simulate(experiment), bus, rng, fails, part.fault_start_s or 0.0)
    block = samples(sent, bus, PERIOD_NS)
    first = round(part.start_s * 1e9 / PERIOD_NS)
    values, t_ns = block.values[first:], block.t_ns[first:]
    return Recording(
        path=Path(f"{part.cycle}_v{vehicle}_s{part.seed}.simulated"),
        sha256=hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest(),
        period_ns=PERIOD_NS,
        t_s=(t_ns - t_ns[0]) / 1e9,
        names=tuple(bus.names),
        values=values,
        quality=block.quality[first:],
    )


@cache
def _bus() -> BusMap:
    return own_bus()
