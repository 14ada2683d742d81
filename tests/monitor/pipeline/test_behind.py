"""Simulated vehicles with a sensor behind the catalyst, from the ECU's frames to codes."""

from collections import deque

import numpy as np

from monitor.base import config
from monitor.judge.catalyst.watch import CatalystMonitor
from tests.helpers.drives.simulated_drives import sampled
from training.dyno import effects, vehicle
from training.dyno.simulation import Experiment


def test_a_voltage_that_mostly_rests_is_no_evidence_of_an_offset() -> None:
    # GIVEN a sound vehicle in town whose ECU cuts no fuel, so that little moves the voltage
    drive = Experiment(
        cycle="micro_trips",
        vehicle=1124,
        seed=1124,
        duration_s=600.0,
        downstream=True,
        effects=effects.from_severities({"ethanol": 0.97}),
        conditions=vehicle.conditions(1124)._replace(overrun_cut=0.0),
    )
    block, names = sampled(drive, np.random.default_rng(1124))
    monitor = CatalystMonitor(config.shipped(), names, 0.1)
    running = np.ones(len(block.values), dtype=np.bool_)
    deque(monitor.push(block.values, running), maxlen=0)
    entry = monitor.entry()
    # THEN it is sound, and so is the upstream sensor
    assert entry is not None
    assert (entry["verdict"], entry["balance_verdict"]) == ("passed", "passed")
