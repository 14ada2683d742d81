"""Simulated vehicles with a sensor behind the catalyst, from the ECU's frames to codes."""

from collections import deque
from pathlib import Path

import numpy as np
import pytest

from monitor.base import config, faults
from monitor.judge.catalyst.watch import CatalystMonitor
from monitor.pipeline.replay import replay, set_up
from tests.helpers.drives.simulated_drives import sampled
from training.dyno import effects, vehicle
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment

DRIVE = {"vehicle": 21, "seed": 8, "duration_s": 420.0, "downstream": True}


@pytest.mark.parametrize(
    ("fault", "codes"),
    [("biased_lean", {"P2097", "P2195"}), ("biased_rich", {"P2096", "P2196"})],
)
def test_codes_follow_from_the_frames(fault: str, codes: set[str], tmp_path: Path) -> None:
    log = write(Experiment(**DRIVE, fault=faults.resolve(fault, 0.025)), tmp_path, "blf")
    recording, _ = replay(log, set_up(None, [], config.shipped()))
    assert {dtc["code"] for dtc in recording["dtcs"]} == codes
    assert recording["catalyst"]["segments"] > 30


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
