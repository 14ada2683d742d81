"""Probabilities of hypotheses: in how many resamples of the blocks each is the answer."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.helpers.gap.gap_drives import BASE, PERIOD_S
from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name.posterior import Posterior, on_top, posterior
from training.gap.name.ranking import rank
from training.gap.name.verdict import Candidate
from training.greybox.chain import base_path, simulate
from training.greybox.effects import LIBRARY
from training.greybox.fit.drive import ChainDrive, make, phi_of
from training.greybox.fit.joint import fit
from training.greybox.fit.sensor_faults import FAULTS
from training.greybox.quantity.dynamics import lag
from training.healthy.base_state import BaseState, base_state


@pytest.fixture(scope="module")
def filmed() -> tuple[BaseState, tuple[Candidate, ...]]:
    """Return drives with a wall film, and the film and a fuel cut's tail fitted to them."""
    state = base_state(two_drives(2_200_140, ("wall_film", 4.0)), known(), known().base)
    return state, rank(state, [LIBRARY["wall_film"], LIBRARY["fuel_cut_tail"]])


def weighed(state: BaseState, ranking: Sequence[Candidate], **merit: Any) -> Posterior:
    """Return the probabilities, the first candidate with other merits."""
    first = replace(ranking[0], merit=replace(ranking[0].merit, **merit))
    return posterior(state, [first, *ranking[1:]], state.deviance)


def test_an_effect_in_the_direction_that_it_cannot_have_is_a_hypothesis_of_its_own(
    filmed: tuple[BaseState, tuple[Candidate, ...]],
) -> None:
    found = weighed(*filmed, physical=False)
    assert found["wall_film reversed"] > 0.95
    assert "wall_film" not in found


def test_a_candidate_that_leaves_most_of_what_can_be_explained_speaks_for_another_cause(
    filmed: tuple[BaseState, tuple[Candidate, ...]],
) -> None:
    state, (_, tail) = filmed
    found = weighed(state, (tail,), needed=0.0)
    assert found["fuel_cut_tail"] < 0.05
    assert found["unknown"] > 0.5


def steady(rpm: float, air_mg: float, slow_s: float) -> ChainDrive:
    """Return ten minutes at one operating point, the mixture modulated, with a slow sensor."""
    rng, n = np.random.default_rng(int(rpm)), 6000
    phi = 1.0 + 0.05 * np.sign(np.sin(np.arange(n) * PERIOD_S * 2.1))
    signals = {
        "engine_speed_rpm": rpm + rng.standard_normal(n),
        "air_mass_mg": air_mg + rng.standard_normal(n),
    }
    signals["fuel_mass_mg"] = signals["air_mass_mg"] / 14.7 * phi
    read = lag(simulate(base_path(BASE, signals), PERIOD_S), slow_s, PERIOD_S)
    read += 0.003 * rng.standard_normal(n)
    return make(f"{rpm:.0f} rpm", PERIOD_S, signals, 1.0 / read)


def test_a_slow_sensor_at_one_steady_point_a_drive_is_likeliest_though_no_signal_moves() -> None:
    drives = [steady(1500.0, 200.0, 0.5), steady(3000.0, 450.0, 0.5)]
    begun = base_state(drives, None, BASE)
    case = replace(begun.case, fixed=BASE)  # as of a vehicle that is known
    state = replace(begun, case=case).with_fit(fit(case, (), [BASE]))
    slow = rank(state, [fault for fault in FAULTS if fault.name == "slow_symmetric"])
    assert posterior(state, slow, state.deviance)["slow_symmetric"] > 0.95


def test_what_effects_in_a_model_move_counts_without_a_healthy_reference_too() -> None:
    drive = steady(1500.0, 200.0, 0.5)
    moved = replace(drive, moved_phi=0.8 * (drive.phi_measured - phi_of(drive, BASE)))
    state = base_state([moved], None, BASE)
    assert state.deviance.sum() < 0.5 * state.own.sum()


def test_a_second_step_parts_the_first_ones_effect_and_a_beaten_rival_from_pairs() -> None:
    first = {"wall_film": 0.7, "purge": 0.2, "unknown": 0.1}
    then = {"purge": 0.5, "none": 0.25, "unknown": 0.25}
    pair = {"wall_film+purge": 0.45, "wall_film": 0.225, "unknown": 0.225, "purge": 0.1}
    assert on_top(first, "wall_film", then, {"purge": 0.5}) == pytest.approx(pair)
