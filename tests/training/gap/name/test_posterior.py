"""Steps of the naming: probabilities, effects one after the other, onsets, next drives."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import BASE, PERIOD_S, case_of, noisy_drive
from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name import steps
from training.gap.name.decision import StepOutcome
from training.gap.name.next_drives import named_after, next_drives
from training.gap.name.onset import onset_s
from training.gap.name.posterior import Posterior, on_top, posterior
from training.gap.name.ranking import WIN, rank
from training.gap.name.steps import advance
from training.gap.name.verdict import Candidate, Verdict
from training.greybox.chain import base_path, simulate
from training.greybox.effects import LIBRARY
from training.greybox.fit.case import Case
from training.greybox.fit.drive import ChainDrive, make, phi_of
from training.greybox.fit.joint import JointFit, fit
from training.greybox.fit.sensor_faults import FAULTS
from training.greybox.quantity.dynamics import lag
from training.healthy import scoring
from training.healthy.base_state import BaseState, base_state


@cache
def filmed(*names: str) -> tuple[BaseState, tuple[Candidate, ...]]:
    """Return drives with a wall film, and these effects fitted to them."""
    state = base_state(two_drives(2_200_140, ("wall_film", 4.0)), known(), known().base)
    ranking = rank(state, [LIBRARY[name] for name in names], lambda _: None)
    return state, tuple(next(c for c in ranking if c.name == name) for name in names)


def weighed(state: BaseState, ranking: Sequence[Candidate], **merit: Any) -> Posterior:
    """Return the probabilities, the first candidate with other merits."""
    first = replace(ranking[0], merit=replace(ranking[0].merit, **merit))
    return posterior(state, [first, *ranking[1:]], state.deviance)


def test_an_effect_in_the_direction_that_it_cannot_have_is_a_hypothesis_of_its_own() -> None:
    found = weighed(*filmed("wall_film", "fuel_cut_tail"), physical=False)
    assert found["wall_film reversed"] > 0.95
    assert "wall_film" not in found


def test_a_candidate_that_leaves_most_of_what_can_be_explained_speaks_for_another_cause() -> None:
    state, (_, tail) = filmed("wall_film", "fuel_cut_tail")
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


TRIED = ("wall_film", "maf_offset", "exhaust_leak")
ALL = dict.fromkeys((*TRIED, "none", "unknown"), 0.2)


@pytest.mark.parametrize(("verdict", "beside"), [("ambiguous", (0, 2)), ("no_gap", ())])
def test_a_name_stays_whatever_cannot_be_named_on_top_of_it(
    verdict: Verdict, beside: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a first step that names an effect, and a second one that names none on top of it
    state, every = filmed(*TRIED)
    rivals = tuple(every[i] for i in beside)
    said = iter(
        [
            StepOutcome("named", every, best=every[1:2], posterior=ALL),
            StepOutcome(verdict, every, best=rivals, posterior=ALL),
        ]
    )
    monkeypatch.setattr(steps, "step", lambda *_: next(said))
    # WHEN both are done THEN the name stays
    found = advance(state, [LIBRARY[name] for name in TRIED], 2, True, lambda _: None)
    assert [r.effect.name for r in found.rounds] == ["maf_offset"]
    assert found.outcome.verdict == "named"
    assert found.beside == rivals


BEGINS = (np.arange(6000) > 2500).astype(float)


def explained(
    strength: FloatArray, size: FloatArray | None = None
) -> tuple[Case, JointFit, JointFit]:
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
    found = onset_s(*explained(BEGINS))
    assert found is not None
    assert found[0] == "drive 1"
    assert found[1] == pytest.approx(285.0, abs=75.0)
    assert onset_s(*explained(np.ones(6000))) is None
    assert onset_s(*explained(0.6 + 0.4 * BEGINS)) is None


def test_a_little_that_hardly_shows_before_is_no_onset() -> None:
    # GIVEN an effect that is not there where it would hardly show, such as while the engine is cold
    for before, onset in ((0.4, False), (2.0, True)):  # of the size where it is there
        size = np.where(BEGINS > 0.0, 5.0, before)
        assert (onset_s(*explained(BEGINS, size)) is not None) == onset


BLOCKS = 40


@pytest.mark.parametrize("lead", [0.0, 1.0, 1.6])
def test_the_promised_probability_is_that_with_which_further_blocks_name(lead: float) -> None:
    # GIVEN blocks in which a rival leaves more by ``lead`` standard errors of their mean
    rng = np.random.default_rng(3)
    blocks = rng.standard_normal(BLOCKS)
    blocks += lead * blocks.std() / np.sqrt(BLOCKS) - blocks.mean()
    # WHEN three times as many come from where such blocks may come from
    named = []
    for _ in range(100):
        mean = rng.normal(blocks.mean(), blocks.std() / np.sqrt(BLOCKS))
        more = rng.normal(mean, blocks.std(), 3 * BLOCKS)
        named.append(scoring.win(np.zeros(4 * BLOCKS), np.concatenate([blocks, more])) >= WIN)
    # THEN the draws of all name it as often as was said
    assert np.mean(named) == pytest.approx(named_after(3, blocks), abs=0.1)


def test_driving_is_proposed_until_the_first_is_likely_named_and_none_for_one_alone() -> None:
    drive = noisy_drive(1, effect="injector_offset", value=0.05)
    state = base_state([drive], None, BASE)
    right, *rivals = rank(state, [LIBRARY[n] for n in ("injector_offset", "maf_offset", "purge")])
    present_s = float(drive.kept.sum()) * drive.period_s
    soon, late = next_drives(state.case, (right, *rivals)), next_drives(state.case, rivals)
    assert soon is not None and (soon.name, soon.seconds) == ("injector_offset", present_s)
    assert late is not None and late.seconds == 7 * present_s and late.probability < 0.8
    assert f"{round(present_s / 60.0)}\N{NO-BREAK SPACE}min more like these" in str(soon)
    assert next_drives(state.case, (right,)) is None
