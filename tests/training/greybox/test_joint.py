"""The joint fit of the chain's constants and effects, on drives of plain formulas."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from tests.helpers.drives.recordings import recording_of
from tests.helpers.gap.gap_drives import BASE, PERIOD_S, case_of, noisy_drive, plain_signals
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.effects import LIBRARY
from training.greybox.fit import drive as drives
from training.greybox.fit import ridge
from training.greybox.fit.case import plain_errors, predict, shrink
from training.greybox.fit.drive import make
from training.greybox.fit.joint import fit, held_out, held_out_rmse


def test_the_base_is_found_again_from_far_away() -> None:
    found = fit(case_of(noisy_drive(1), noisy_drive(2)), (), [Constants()])
    assert found.base.gain == pytest.approx(BASE.gain, abs=5e-4)
    assert found.base.span == pytest.approx(BASE.span, abs=0.02)
    assert found.base.mixing_s + found.base.sensor_s == pytest.approx(0.15, abs=0.01)


def test_an_effect_is_found_with_its_constant_within_its_standard_errors() -> None:
    case = case_of(noisy_drive(1, effect="injector_offset", value=0.3))
    alone = fit(case, (), [Constants()])
    found = fit(case, (LIBRARY["injector_offset"],), [alone])
    error = float(found.standard_errors[0][0])
    assert 0.0 < error < 0.02
    assert float(found.parameters[0][0]) == pytest.approx(0.3, abs=4.0 * error)
    assert found.cost < 0.8 * alone.cost


def test_a_prior_holds_the_base_where_the_data_would_move_it() -> None:
    drive = noisy_drive(1)
    reference = BASE._replace(gain=1.02)
    tight = (reference, Constants(*(1e-6,) * 6))
    held = fit(replace(case_of(drive), prior=tight), (), [reference])
    assert held.base.gain == pytest.approx(1.02, abs=1e-4)
    assert fit(case_of(drive), (), [reference]).base.gain == pytest.approx(1.01, abs=1e-3)


def test_a_constant_that_the_drives_do_not_hold_stays_where_it_is_expected() -> None:
    # GIVEN a warm engine with a wall film: how it grows in the cold cannot be seen
    signals = plain_signals(seed=1) | {"coolant_temperature_degc": np.full(6000, 90.0)}
    signals = {name: x[:6000] for name, x in signals.items()}
    path = LIBRARY["wall_film"].apply(
        base_path(BASE, signals), np.array([0.1, 0.6, 3.0]), signals, PERIOD_S
    )
    phi = simulate(path, PERIOD_S)
    phi += 0.003 * np.random.default_rng(1).standard_normal(len(phi))
    warm = make("warm", PERIOD_S, signals, 1.0 / np.maximum(phi, 0.07))
    alone = fit(case_of(warm), (), [Constants()])
    # WHEN it is fitted
    found = fit(case_of(warm), (LIBRARY["wall_film"],), [alone])
    # THEN what can be seen is found, and the rest is as expected, with its uncertainty
    share, time_s, cold_growth = found.parameters[0]
    assert (share, time_s) == (pytest.approx(0.1, rel=0.2), pytest.approx(0.6, rel=0.3))
    assert cold_growth == pytest.approx(1.0, abs=0.01)
    assert found.standard_errors[0][2] == pytest.approx(1.0, abs=0.05)


def test_held_out_errors_are_those_of_a_fit_without_the_fold() -> None:
    drive = noisy_drive(1)
    case = case_of(drive)
    found = fit(case, (), [BASE])
    quick = held_out(found, case.blocks)
    fold = np.zeros(len(drive), dtype=bool)
    fold[drive.kept] = case.blocks % 5 == 0
    without = case_of(replace(drive, scored=drive.scored & ~fold))
    slow_base = fit(without, (), [BASE]).base
    slow = plain_errors(case, predict(case, slow_base, (), ())) / case.sigma
    out = case.blocks % 5 == 0
    np.testing.assert_allclose(quick[out], slow[out], atol=0.02)
    assert np.mean(quick**2) > np.mean(found.residual**2)


def test_the_held_out_rmse_is_the_noise_where_the_model_is_right() -> None:
    case = case_of(noisy_drive(1), noisy_drive(2))
    assert held_out_rmse(case, fit(case, (), [BASE])) == pytest.approx(0.003, rel=0.03)


def test_a_ridge_predicts_what_is_there_and_nothing_of_noise() -> None:
    rng = np.random.default_rng(1)
    x = rng.standard_normal((4000, 8))
    y = 0.5 * x[:, 2] + 0.1 * rng.standard_normal(4000)
    fold = np.arange(4000) // 100 % 5
    found = ridge.fit(x, y, fold)
    assert found.predict(x) == pytest.approx(0.5 * x[:, 2], abs=0.05)
    pure = rng.standard_normal(4000)
    assert np.mean((pure - ridge.fit(x, pure, fold).held_out) ** 2) > 0.99 * np.mean(pure**2)


def test_a_ridge_says_of_what_hardly_moved_what_is_known_of_it() -> None:
    # GIVEN two columns whose weights are known to be much alike, one of which hardly moves
    rng = np.random.default_rng(2)
    x = rng.standard_normal((4000, 2)) * [1.0, 0.02]
    y = x @ [2.0, 9.0] + rng.standard_normal(4000)
    fold = np.arange(4000) // 100 % 5
    alike = np.array([[1.0, -1.0], [-1.0, 1.0]]) / 0.1**2
    # THEN that one's weight is the other's, and not what its small moves say
    assert ridge.fit(x, y, fold).weights[1] > 5.0
    assert ridge.fit(x, y, fold, prior=alike).weights == pytest.approx([2.0, 2.0], abs=0.3)
    # nor is one that did not move at all without a weight
    still = x * [1.0, 0.0]
    assert ridge.fit(still, y, fold).weights[1] == 0.0
    assert ridge.fit(still, y, fold, prior=alike).weights == pytest.approx([2.0, 2.0], abs=0.1)


def test_random_coefficients_take_out_their_own_direction_and_leave_the_rest() -> None:
    rng = np.random.default_rng(2)
    column = rng.standard_normal((1000, 1))
    root = shrink(10.0 * column)
    assert np.abs(root.apply(3.0 * column[:, 0])).max() < 0.05
    other = rng.standard_normal(1000)
    other -= column[:, 0] * (other @ column[:, 0]) / (column[:, 0] @ column[:, 0])
    np.testing.assert_allclose(root.apply(other), other, atol=1e-6)
    np.testing.assert_allclose(root.apply(other[:, None])[:, 0], other, atol=1e-6)
    # the covariance that the root stands for
    whole = np.linalg.inv(np.eye(1000) + 100.0 * column @ column.T)
    np.testing.assert_allclose(
        root.apply(root.apply(column[:, 0])), whole @ column[:, 0], atol=1e-6
    )


def _make(signals: dict[str, FloatArray], lambda_measured: FloatArray) -> drives.ChainDrive:
    return drives.make("d", PERIOD_S, signals, lambda_measured)


def test_fuel_cut_and_the_recovery_from_it_are_not_scored() -> None:
    signals = plain_signals()
    drive = _make(signals, np.ones(6000))
    cut = signals["fuel_mass_mg"] == 0.0
    assert not drive.scored[cut].any()
    first_after = int(np.flatnonzero(np.diff(cut.astype(int)) == -1)[0]) + 1
    recovery = round(drives.RECOVERY_S / PERIOD_S)
    assert not drive.scored[first_after : first_after + recovery].any()
    assert drive.scored[first_after + recovery]


def test_a_cut_that_is_read_late_is_not_scored_either() -> None:
    # GIVEN a vehicle whose exhaust takes three seconds to the sensor
    signals = plain_signals()
    cut = signals["fuel_mass_mg"] == 0.0
    read = np.concatenate([np.zeros(30, dtype=bool), cut[:-30]])
    drive = _make(signals, np.where(read, 15.0, 1.0))
    # THEN nothing counts until a second after the sensor has read the cut's end
    assert not drive.scored[read].any()
    last = int(np.flatnonzero(np.diff(read.astype(int)) == -1)[0])
    assert not drive.scored[last : last + 11].any()
    assert drive.scored[last + 11]


@pytest.mark.parametrize("name", ["air_mass_mg", "fuel_mass_mg", "engine_speed_rpm"])
def test_a_gap_in_an_input_is_held_and_not_scored(name: str) -> None:
    signals = plain_signals()
    values = signals[name].copy()
    values[3000:3010] = np.nan
    drive = _make(signals | {name: values}, np.ones(6000))
    np.testing.assert_array_equal(drive.signals[name][3000:3010], np.full(10, values[2999]))
    assert not drive.scored[3000 : 3010 + 49].any()


def test_missing_lambda_is_not_scored_and_phi_stays_finite() -> None:
    measured = np.full(6000, 1.25)
    measured[:200] = np.nan
    measured[4000:4100] = np.nan
    drive = _make(plain_signals(), measured)
    assert not drive.scored[:200].any()
    assert not drive.scored[4000:4100].any()
    np.testing.assert_array_equal(drive.phi_measured, np.full(6000, 0.8))


def test_a_sensor_that_is_not_ready_is_not_scored() -> None:
    ready = (np.arange(6000) > 1000).astype(float)
    drive = _make(plain_signals() | {"sensor_ready": ready}, np.ones(6000))
    assert not drive.scored[:1001].any()
    assert drive.scored[1001:].any()


def test_engine_speed_follows_from_air_meter_and_charge() -> None:
    signals = plain_signals()
    rpm = signals.pop("engine_speed_rpm")
    drive = _make(signals, np.ones(6000))
    np.testing.assert_allclose(drive.signals["engine_speed_rpm"], rpm, rtol=1e-9)


def test_a_drive_that_is_too_short_is_refused_with_what_was_wanted() -> None:
    with pytest.raises(RecordingError, match="s can be scored, 60 wanted"):
        _make(plain_signals(400), np.ones(400))


def test_a_recording_becomes_a_drive_of_its_name_and_one_without_fuel_is_refused() -> None:
    columns = plain_signals() | {"lambda_measured": np.ones(6000)}
    drive = drives.from_recording(recording_of(columns))
    assert (drive.name, drive.period_s) == ("drive.csv", PERIOD_S)
    np.testing.assert_array_equal(drive.signals["air_mass_mg"], columns["air_mass_mg"])
    del columns["fuel_mass_mg"]
    with pytest.raises(RecordingError, match=r"drive\.csv: has no good value of fuel_mass_mg"):
        drives.from_recording(recording_of(columns))


def test_a_network_of_air_and_fuel_is_looked_at_without_engine_speed() -> None:
    signals = {k: x for k, x in plain_signals().items() if k in ("air_mass_mg", "fuel_mass_mg")}
    reading = np.ones(len(signals["fuel_mass_mg"]))
    with pytest.raises(RecordingError, match="neither engine_speed_rpm nor maf_kg_h"):
        drives.make("d", PERIOD_S, signals, reading)
    assert drives.make("d", PERIOD_S, signals, reading, needed=tuple(signals)).scored.any()
