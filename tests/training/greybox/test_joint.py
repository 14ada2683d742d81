"""The joint fit of the chain's constants and effects, on drives of plain formulas."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.gap.gap_drives import BASE, PERIOD_S, case_of, noisy_drive, plain_signals
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.effects import LIBRARY
from training.greybox.fit.case import plain_errors, predict
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
