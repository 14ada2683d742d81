"""Fitting, scoring and guards of the gap workflow on drives of plain formulas."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base import faults
from monitor.base.types import FloatArray
from tests.helpers.gap_drives import BASE, PERIOD_S, case_of, noisy_drive, plain_signals
from training.gap.name import guards, scoring
from training.gap.name.manoeuvres import library, separate
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.effects import LIBRARY
from training.greybox.fit import ridge
from training.greybox.fit.drive import make
from training.greybox.fit.joint import (
    Case,
    Fit,
    Prior,
    fit,
    held_out,
    held_out_rmse,
    plain_errors,
    predict,
)
from training.greybox.fit.sensor_faults import FAULTS
from training.greybox.fit.variation import shrink

FAULT = {fault.name: fault for fault in FAULTS}


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
    tight = Prior(reference, Constants(*(1e-6,) * 6))
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


def test_a_real_effect_scores_and_a_useless_one_does_not() -> None:
    case = case_of(
        noisy_drive(1, effect="purge", value=0.5), noisy_drive(2, effect="purge", value=0.5)
    )
    alone = fit(case, (), [Constants()])
    before = scoring.deviance(alone, case.blocks)
    after = {
        name: scoring.deviance(fit(case, (LIBRARY[name],), [alone]), case.blocks)
        for name in ("purge", "back_pressure")
    }
    assert scoring.score(before, after["purge"]).gain > 100.0
    assert scoring.score(before, after["back_pressure"]).t < 3.0
    assert scoring.win(after["purge"], after["back_pressure"]) > 0.95


def test_blocks_in_which_two_models_agree_do_not_count_for_t() -> None:
    before = np.full(40, 300.0)
    after = before.copy()
    after[:10] -= 50.0 + np.arange(10)
    moved = np.where(np.arange(40) < 10, 60.0, 0.0)
    assert scoring.score(before, after, moved).t > 2.0 * scoring.score(before, after).t
    assert scoring.score(before, after, np.zeros(40)).t == 0.0


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
    root = shrink(column, np.array([10.0]))
    assert np.abs(root.apply(3.0 * column[:, 0])).max() < 0.05
    other = rng.standard_normal(1000)
    other -= column[:, 0] * (other @ column[:, 0]) / (column[:, 0] @ column[:, 0])
    np.testing.assert_allclose(root.apply(other), other, atol=1e-9)
    np.testing.assert_allclose(root.apply_columns(other[:, None])[:, 0], other, atol=1e-9)
    # the covariance that the root stands for
    whole = np.linalg.inv(np.eye(1000) + 100.0 * column @ column.T)
    np.testing.assert_allclose(
        root.apply(root.apply(column[:, 0])), whole @ column[:, 0], atol=1e-9
    )


def _explained(strength: FloatArray, size: FloatArray | None = None) -> tuple[Case, Fit, Fit]:
    """Return a case whose gap is a signature times a strength by sample, and both fits.

    size : of the signature, default 1
    """
    drive = noisy_drive(1)
    case = case_of(drive)
    m = int(drive.kept.sum())
    rng = np.random.default_rng(3)
    signature = (1.0 if size is None else size[:m]) * np.sin(np.arange(m) / 7.0)
    before = fit(case, (), [BASE])
    gap = strength[:m] * signature + rng.standard_normal(m)
    return case, replace(before, residual=-gap), replace(before, residual=-gap + signature)


def test_what_begins_within_a_drive_is_an_onset_and_what_is_always_there_is_none() -> None:
    begins = (np.arange(6000) > 2500).astype(float)
    found = guards.onset_s(*_explained(begins))
    assert found is not None
    assert found[0] == "drive 1"
    assert found[1] == pytest.approx(285.0, abs=75.0)
    assert guards.onset_s(*_explained(np.ones(6000))) is None
    assert guards.onset_s(*_explained(0.6 + 0.4 * begins)) is None


def test_a_little_that_hardly_shows_before_is_no_onset() -> None:
    # GIVEN an effect that is not there where it would hardly show, such as while the engine is cold
    begins = (np.arange(6000) > 2500).astype(float)
    for before, onset in ((0.4, False), (2.0, True)):  # of the size where it is there
        size = np.where(begins > 0.0, 5.0, before)
        assert (guards.onset_s(*_explained(begins, size)) is not None) == onset


def test_a_shift_of_gain_or_of_the_whole_lag_is_said_and_a_small_one_is_not() -> None:
    assert guards.shifted(BASE, BASE._replace(gain=1.0155)) == "the gain"
    assert guards.shifted(BASE, BASE._replace(sensor_s=0.14)) == "the lag or dead time"
    assert guards.shifted(BASE, BASE._replace(dead_time_revolutions=2.2)) == "the lag or dead time"
    traded = BASE._replace(sensor_s=BASE.sensor_s + 0.05, dead_time_s=BASE.dead_time_s - 0.05)
    assert guards.shifted(BASE, traded) is None
    assert guards.shifted(BASE, BASE._replace(gain=1.013)) is None


@pytest.mark.parametrize(
    ("name", "severity"),
    [
        ("slow_rich_to_lean", 0.4),
        ("slow_lean_to_rich", 0.4),
        ("slow_symmetric", 0.4),
        ("delay_rich_to_lean", 0.4),
        ("delay_lean_to_rich", 0.4),
        ("delay_symmetric", 0.4),
        ("gain_low", 0.6),
        ("biased_lean", 0.05),
    ],
)
def test_a_sensor_fault_reads_as_the_monitors_definition_does(name: str, severity: float) -> None:
    phi = simulate(base_path(BASE, plain_signals()), PERIOD_S)
    fault = faults.resolve(name, severity)
    rival = FAULT["biased" if name.startswith("biased") else name]
    ours = rival.read(phi, np.array([severity]), PERIOD_S)
    steps = round(fault.delay_s / PERIOD_S)
    slow, wanted = phi[0], np.empty_like(phi)
    for k in range(len(phi)):
        u = faults.one_sided(phi[k], phi[max(k - steps, 0)], fault.delay_direction)
        slow = faults.lag_step(slow, u, fault.tau_rising_s, fault.tau_falling_s, PERIOD_S)
        reading = 1.0 / max(1.0 + fault.gain * (slow - 1.0), 1.0 / 16.0) + fault.offset_lambda
        wanted[k] = 1.0 / min(max(reading, 0.5), 16.0)
    above = wanted > 0.07  # the monitor sends no more than 16 in lambda
    np.testing.assert_allclose(ours[above], wanted[above], atol=1e-9)


def test_the_manoeuvre_that_separates_two_models_is_the_one_they_differ_on() -> None:
    case = case_of(noisy_drive(1))
    alone = fit(case, (), [BASE])
    film = replace(alone, terms=(LIBRARY["wall_film"],), parameters=(np.array([0.2, 0.6, 2.0]),))
    leak = replace(
        alone, terms=(LIBRARY["exhaust_leak"],), parameters=(np.array([0.05, 30.0, 0.5]),)
    )
    dynamic = separate(film, alone)
    static = separate(leak, alone)
    assert "tip-in" in dynamic.name
    assert "1,500 rpm" in static.name or "speed sweep" in static.name
    assert dynamic.difference["motorway at 2,600 rpm"] < 0.3 * dynamic.rms_phi
    assert set(dynamic.difference) == set(library())
    assert dynamic.name in str(dynamic)
