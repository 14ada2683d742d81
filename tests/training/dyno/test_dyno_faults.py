"""Sensor faults inside the control loop of the simulated dynamometer."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.sensor.plan import NOT_AFTERWARDS
from monitor.base import faults
from tests.helpers.drives.simulated_drives import FAULT_DRIVE, SHORT, WARM, differs, driven, rms
from training.dyno import cycles, drive, ecu, mixture, vehicle
from training.dyno.effects import Effects
from training.dyno.mixture import Mixture
from training.dyno.simulation import Experiment
from training.recordings.sensor_fault import faulty_readings

STEP_S = cycles.STEP_S


def plant(experiment: Experiment) -> Mixture:
    """The mixture loop with what a healthy sensor would read."""
    trace = cycles.load(experiment.cycle, np.random.default_rng(1), experiment.duration_s)
    piece = vehicle.piece(experiment.vehicle)
    air = drive.run(trace, piece, WARM, Effects(), np.random.default_rng(2))
    return mixture.run(
        air,
        piece,
        c=WARM,
        e=Effects(),
        fault=experiment.fault,
        start_s=0.0,
        rng=np.random.default_rng(3),
        phi_step=trace.phi_step,
    )


@pytest.mark.parametrize("name", faults.NAMES)
def test_every_fault_acts_inside_the_control_loop(name: str) -> None:
    healthy = driven(FAULT_DRIVE)
    faulty = driven(replace(FAULT_DRIVE, fault=faults.resolve(name), fault_start_s=100.0))
    before, after = slice(0, 10_000), slice(10_100, None)
    for signal in ("lambda_controller", "lambda_measured", "fuel_mass_mg"):
        np.testing.assert_array_equal(faulty[signal][before], healthy[signal][before])
    # THEN the controller reacts, and fuel with it
    for signal in ("lambda_controller", "fuel_mass_mg"):
        assert rms(faulty[signal][after] / np.maximum(healthy[signal][after], 1e-9) - 1.0) > 0.002
    assert differs(faulty, healthy, "lambda_measured")
    # and nothing reaches the air path
    for signal in ("air_mass_mg", "engine_speed_rpm", "manifold_pressure_kpa", "fuel_cut"):
        np.testing.assert_array_equal(faulty[signal], healthy[signal])


@pytest.mark.parametrize("name", [n for n in faults.NAMES if n not in NOT_AFTERWARDS])
def test_in_the_loop_a_fault_is_what_it_is_defined_to_be(name: str) -> None:
    # GIVEN what a healthy sensor would read in the faulty drive
    fault = faults.resolve(name)
    got = plant(replace(FAULT_DRIVE, fault=fault))
    # WHEN the fault as defined is put onto it
    healthy_lambda = 1.0 / np.maximum(got.phi_sensor, 1e-9)  # in fuel cut noise crosses 0
    expected = faulty_readings(fault, healthy_lambda, STEP_S)
    # THEN the ECU has read that; leaving out fuel cut, where its value ends, and the start
    inside = (expected < 12.0) & (np.arange(len(expected)) > 500)
    assert inside.mean() > 0.8
    error = np.abs(1.0 / got.lambda_measured[inside] - 1.0 / expected[inside])
    assert np.median(error) < 1e-9
    below_zero = max(-float(got.phi_sensor.min()), 0.0)
    assert error.max() <= 1.5 * below_zero + 1e-9
    assert below_zero < 0.02


@pytest.mark.parametrize(
    ("name", "sign"),
    [("biased_lean", 1.0), ("stuck_lean", 1.0), ("biased_rich", -1.0), ("stuck_rich", -1.0)],
)
def test_the_controller_corrects_against_what_the_sensor_says(name: str, sign: float) -> None:
    healthy = driven(FAULT_DRIVE)["lambda_controller"]
    faulty = driven(replace(FAULT_DRIVE, fault=faults.resolve(name)))["lambda_controller"]
    assert sign * (faulty - healthy)[20_000:].mean() > 0.03


def test_a_biased_sensor_reads_right_and_the_engine_runs_wrong() -> None:
    # the trap of an offset in closed loop: the reading is pulled to the target
    fault = faults.resolve("biased_lean", 0.08)
    got = plant(replace(FAULT_DRIVE, fault=fault))
    on = (got.closed_loop > 0.5) & (np.arange(len(got.closed_loop)) > 10_000)
    assert np.mean(1.0 / got.lambda_measured[on]) == pytest.approx(1.0, abs=0.02)
    assert np.mean(got.phi_sensor[on]) > 1.05


def test_a_missing_signal_stops_its_message_only() -> None:
    fault = faults.resolve("signal_missing")
    sent = ecu.broadcast(
        driven(SHORT), ecu.own_bus(), np.random.default_rng(0), fault, fault_start_s=30.0
    )
    last_s = {b.outgoing.message.name: b.times_ns[-1] / 1e9 for b in sent}
    assert last_s.pop("ECU_Lambda") == pytest.approx(30.0, abs=0.05)
    assert min(last_s.values()) > 58.0
