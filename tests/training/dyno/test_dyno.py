"""The simulated chassis dynamometer. It is synthetic, and it is the same every time."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.studies.sensor.plan import NOT_AFTERWARDS
from monitor.base import faults
from monitor.base.errors import UsageError
from monitor.base.signals import OWN
from tests.conftest import ROOT
from tests.helpers.drives.simulated_drives import (
    FAULT_DRIVE,
    SHORT,
    WARM,
    differs,
    driven,
    rms,
    to_grid,
)
from training.cli.simulate import FORMATS
from training.dyno import cycles, drive, ecu, effects, mixture, vehicle
from training.dyno.effects import Effects
from training.dyno.mixture import Mixture
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment, simulate
from training.recordings import recording
from training.recordings.sensor_fault import faulty_readings

STEP_S = cycles.STEP_S


# The same call gives the same bytes


@pytest.mark.parametrize("suffix", ["log.gz", *(f for f in FORMATS if f not in ("asc", "trc"))])
def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    # GIVEN two folders, and an older drive in one
    experiment = replace(SHORT, duration_s=20.0, fault=faults.resolve("gain_low"))
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    write(replace(experiment, duration_s=5.0), second, suffix)
    # WHEN the same drive is written into both
    one, two = (write(experiment, folder, suffix).read_bytes() for folder in (first, second))
    # THEN the files are equal, and not empty
    assert one == two
    assert len(one) > 5_000


def test_a_file_that_is_no_simulated_drive_is_not_replaced(tmp_path: Path) -> None:
    experiment = Experiment(seed=3, duration_s=5.0)
    path = write(experiment, tmp_path, "log")
    assert write(experiment, tmp_path, "log") == path
    path.write_text("mine")
    with pytest.raises(UsageError, match="no simulated drive"):
        write(experiment, tmp_path, "log")
    assert path.read_text() == "mine"


def test_another_process_gives_the_same_bytes(tmp_path: Path) -> None:
    experiment = Experiment(
        seed=3, duration_s=20.0, effects=effects.from_severities({"purge": 2.0})
    )
    here = write(experiment, tmp_path, "log")
    call = ["simulate", "--duration", "20", "--seed", "3", "--effect", "purge=2", "--out"]
    code = "import sys, training.cli as cli; sys.exit(cli.main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", code, *call, str(tmp_path / "there")],
        cwd=ROOT,
        env=os.environ | {"PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    there = tmp_path / "there" / here.name
    assert done.stdout.strip() == str(there)
    assert there.read_bytes() == here.read_bytes()


def test_another_seed_is_another_drive_of_the_same_piece() -> None:
    one, other = driven(replace(SHORT, seed=1)), driven(replace(SHORT, seed=2))
    for name in ("lambda_measured", "engine_speed_rpm", "air_mass_mg", "rail_pressure_mpa"):
        assert differs(one, other, name), name


def test_another_vehicle_is_another_piece() -> None:
    assert vehicle.piece(3)[:9] == vehicle.piece(3)[:9]
    assert vehicle.piece(3)[:9] != vehicle.piece(4)[:9]
    assert differs(driven(SHORT), driven(replace(SHORT, vehicle=2)), "lambda_measured")


def test_a_file_is_named_after_what_was_driven(tmp_path: Path) -> None:
    experiment = Experiment(
        cycle="udds", vehicle=12, seed=7, fault=faults.resolve("delay_symmetric"), duration_s=3.0
    )
    assert write(experiment, tmp_path, "csv").name == "udds_v12_s7_delay_symmetric.csv"
    assert replace(experiment, fault=None).name == "udds_v12_s7_healthy"
    film = replace(experiment, fault=None, effects=effects.from_severities({"wall_film": 2.0}))
    assert film.name == "udds_v12_s7_wall_film"


# Log and table


@pytest.mark.parametrize(
    ("fault", "period_s"), [(None, 0.04), ("signal_missing", 0.1), ("out_of_range", 0.1)]
)
def test_log_and_table_of_a_drive_give_the_same_samples_bit_for_bit(
    tmp_path: Path, fault: str | None, period_s: float
) -> None:
    experiment = replace(
        SHORT,
        duration_s=45.0,
        fault=None if fault is None else faults.resolve(fault),
        fault_start_s=30.0,
    )
    log = recording.load(write(experiment, tmp_path, "log"), period_s=period_s)
    for suffix in ("parquet", "csv"):
        table = recording.load(write(experiment, tmp_path, suffix, period_s))
        assert table.period_ns == log.period_ns == round(period_s * 1e9)
        np.testing.assert_array_equal(table.t_s, log.t_s)
        for name in log.names:
            np.testing.assert_array_equal(table.column(name), log.column(name), err_msg=name)
    assert len(log.t_s) == pytest.approx(45.0 / period_s, abs=3)
    lost = np.isnan(log.column("lambda_measured")[log.t_s > 31.0])
    assert lost.all() == (fault is not None)


# Every signal


def test_every_canonical_signal_is_there_and_plausible() -> None:
    signals = driven(SHORT)
    assert set(signals) >= {s.name for s in OWN}
    for s in OWN:
        values = signals[s.name]
        assert len(values) == 6000
        finite = values[~np.isnan(values)]
        assert finite.min() >= s.minimum, s.name
        assert finite.max() <= s.maximum, s.name
        if s.name not in ("lambda_measured",):
            assert len(finite) == len(values), s.name
    # the sensor says nothing until it is warm, and something ever after
    silent = np.isnan(signals["lambda_measured"])
    np.testing.assert_array_equal(silent, signals["sensor_ready"] < 0.5)
    assert 0 < silent.sum() < 2000


def test_the_wltc_is_followed_within_2_km_h() -> None:
    trace = cycles.load("wltc_3b", np.random.default_rng(0))
    speed_km_h = driven(Experiment(seed=1))["vehicle_speed_km_h"]
    assert len(speed_km_h) == 180_000  # 1800 s
    assert rms(speed_km_h - 3.6 * trace.speed_m_s) < 2.0


@pytest.mark.parametrize("cycle", cycles.NAMES)
def test_every_cycle_can_be_driven(cycle: str) -> None:
    signals = driven(Experiment(cycle=cycle, duration_s=200.0))
    assert len(signals["closed_loop"]) == 20_000
    assert signals["vehicle_speed_km_h"].max() > 30.0
    assert signals["closed_loop"].mean() > 0.4


@pytest.mark.parametrize("duration_s", [0.0, -5.0])
def test_a_duration_that_is_not_positive_is_an_error(duration_s: float) -> None:
    with pytest.raises(UsageError, match="duration"):
        simulate(Experiment(duration_s=duration_s))


def test_on_overrun_fuel_is_cut_and_the_sensor_reads_air() -> None:
    signals = driven(Experiment(seed=1))
    cut = signals["fuel_cut"] > 0.5
    assert 0.01 < cut.mean() < 0.3
    assert signals["fuel_mass_mg"][cut].max() == 0.0
    assert signals["closed_loop"][cut].max() == 0.0
    starts = np.flatnonzero(np.diff(cut.astype(int)) == 1) + 1
    long = [k for k in starts if cut[k : k + 200].all()]  # two seconds
    assert long
    assert min(signals["lambda_measured"][k + 199] for k in long) > 5.0
    closed = signals["closed_loop"] > 0.5
    assert abs(np.nanmean(1.0 / signals["lambda_measured"][closed]) - 1.0) < 0.01


NOISE_PHI = 0.004
GAP_DRIVE = Experiment(duration_s=900.0)


def gap_phi(experiment: Experiment, hidden: Effects) -> float:
    """RMS of what the effect does to measured phi, the controller's output being replayed."""
    with_effect = simulate(replace(experiment, effects=hidden))
    without = simulate(replace(experiment, forced_trim=with_effect["lambda_controller"]))
    np.testing.assert_array_equal(with_effect["closed_loop"], without["closed_loop"])
    closed = to_grid(with_effect["closed_loop"]) == 1.0
    phi = [to_grid(1.0 / s["lambda_measured"])[closed] for s in (with_effect, without)]
    return rms(phi[0] - phi[1])


@pytest.mark.parametrize("name", effects.NAMES)
def test_an_effect_of_severity_1_makes_a_gap_of_about_the_noise(name: str) -> None:
    gap = gap_phi(GAP_DRIVE, effects.from_severities({name: 1.0}))
    assert NOISE_PHI / 2.5 < gap < NOISE_PHI * 2.5


def test_without_an_effect_there_is_no_gap() -> None:
    assert gap_phi(replace(GAP_DRIVE, duration_s=300.0), Effects()) == 0.0


@pytest.mark.parametrize("name", ["wall_film", "maf_offset", "ethanol", "mix_flow"])
def test_a_larger_severity_makes_a_larger_gap(name: str) -> None:
    experiment = replace(FAULT_DRIVE, seed=4)
    gaps = [gap_phi(experiment, effects.from_severities({name: s})) for s in (0.5, 1.0, 2.0)]
    assert gaps[0] * 1.3 < gaps[1]
    assert gaps[1] * 1.3 < gaps[2]


def test_the_controller_hides_an_effect_in_its_correction() -> None:
    hidden = effects.from_severities({"ethanol": 8.0})
    plain, ethanol = (driven(replace(FAULT_DRIVE, effects=e)) for e in (Effects(), hidden))
    late = slice(20_000, None)
    on = (plain["closed_loop"][late] > 0.5) & (ethanol["closed_loop"][late] > 0.5)
    phi = [1.0 / s["lambda_measured"][late][on].mean() for s in (plain, ethanol)]
    trim = [s["lambda_controller"][late][on].mean() for s in (plain, ethanol)]
    assert abs(phi[1] - phi[0]) < 0.01
    assert trim[1] - trim[0] > 0.02


def test_an_unknown_effect_is_an_error_that_says_which_there_are() -> None:
    with pytest.raises(UsageError, match=r"'wallfilm' is unknown.*wall_film"):
        effects.from_severities({"wallfilm": 1.0})


def test_every_effect_has_a_scale() -> None:
    assert all(scale > 0.0 for scale in effects.SCALE)
    assert effects.from_severities({"purge": 2.0}).purge == 2.0 * effects.SCALE.purge
    assert effects.from_severities({}) == Effects()


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
