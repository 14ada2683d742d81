"""Effects added in the network's graph, on simulated drives of which one has a hidden effect."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.base import config
from monitor.base.errors import RecordingError
from monitor.base.signals import NARX_INPUTS
from monitor.judge.limits import Limits
from monitor.model.step import Model, from_model_units
from monitor.pipeline.replay import shipped_model
from tests.helpers.gap.gap_drives import BASE, case_of, noisy_drive
from tests.helpers.gap.gap_networks import (
    CHAIN,
    FILM,
    FIT,
    assert_judged_alike,
    drive,
    fitted,
    gap_drives,
    inputs_of,
    ranges,
    rmse,
    small_network,
)
from training.gap.add.constants import (
    fit_and_leave_out,
    fit_weighted,
    groups,
    left_out_ratio,
    model_corrections,
)
from training.gap.add.network import add
from training.gap.inputs.roles import Material
from training.gap.inputs.subject import Subject
from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.case import Case
from training.greybox.fit.drive import from_recording, phi_of
from training.greybox.fit.joint import JointFit, fit
from training.greybox.graph.chain_difference import ChainDifference
from training.healthy.base_state import SPREAD_CARD
from training.limits.judging import judge_recordings
from training.narx.export import update_card
from training.narx.fit import FitResult
from training.recordings.prediction import predict, predicted_phi
from training.recordings.recording import Recording

NOTHING = ModelEffect.with_values("injector_offset", [0.0])


def without(recording: Recording, rows: slice, name: str) -> Recording:
    """Return the recording with one signal missing for a while."""
    values = recording.values.copy()
    values[rows, recording.names.index(name)] = np.nan
    return replace(recording, values=values)


def test_the_free_run_in_phi_is_that_of_evaluate() -> None:
    recordings = [drive("wltc_3b", 2_020_101), drive("us06", 2_020_102, duration_s=200.0)]
    found = predicted_phi(shipped_model(), recordings)
    for recording, phi in zip(recordings, found, strict=True):
        model = Model.load(shipped_model())
        _, free, _, scored = predict(model, recording, model.card.lags)
        read = 1.0 / from_model_units("phi", phi)
        assert scored.sum() > 0.9 * len(phi)
        assert np.abs(read - 1.0 / free)[scored].max() < 1e-6


def test_the_free_run_goes_on_over_inputs_that_are_missing_for_a_while() -> None:
    whole = drive("wltc_3b", 2_020_101)
    gap = slice(1000, 1030)
    (held,) = predicted_phi(shipped_model(), [without(whole, gap, "maf_kg_h")])
    (phi,) = predicted_phi(shipped_model(), [whole])
    assert np.isfinite(held).all()
    assert np.array_equal(held[:1000], phi[:1000])
    assert not np.array_equal(held[gap], phi[gap])
    assert np.abs(held - phi)[1100:].max() < 1e-5
    with pytest.raises(RecordingError, match="maf_kg_h is never good"):
        predicted_phi(shipped_model(), [without(whole, slice(None), "maf_kg_h")])


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    return small_network(tmp_path_factory.mktemp("base"))


@pytest.fixture(scope="module")
def extended(base: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("added") / "model.onnx"
    chain, film = fitted()
    add(base.path, [film], chain, out, ranges=ranges(*gap_drives()), recordings=FIT)
    return out


def test_an_effect_of_size_zero_changes_no_bit(base: FitResult, tmp_path: Path) -> None:
    out = tmp_path / "model.onnx"
    add(base.path, [NOTHING], CHAIN, out, ranges=ranges(*gap_drives()), recordings=FIT)
    recordings = gap_drives()[:2]
    for old, new in zip(
        predicted_phi(base.path, recordings), predicted_phi(out, recordings), strict=True
    ):
        assert np.array_equal(old, new)


def test_a_hidden_film_s_gap_shrinks_on_a_drive_no_fit_saw_and_more_with_the_engine_speed(
    base: FitResult, extended: Path, tmp_path: Path
) -> None:
    # GIVEN drives on which nobody broadcasts the engine speed, and a film, which is per stroke
    chain, film = fitted()
    seen = ranges(*gap_drives())
    del seen["engine_speed_rpm"]
    out = tmp_path / "model.onnx"
    # WHEN it is added
    card = add(base.path, [film], chain, out, ranges=seen, recordings=FIT)
    # THEN the file does not ask for it, and predicts better, though this ECU's charge follows its
    # air meter slowly, so that the speed worked out of both is wrong in transients
    assert card.input_names == (*NARX_INPUTS, "coolant_temperature_degc")
    fresh = drive("udds", 2_020_130, FILM)
    before, without_speed, with_speed = (
        rmse(predicted_phi(path, [fresh])[0], from_recording(fresh))
        for path in (base.path, out, extended)
    )
    assert without_speed < 0.95 * before
    assert with_speed < 0.5 * before


def test_the_card_says_what_was_added_and_from_what_and_the_monitor_judges_with_it(
    base: FitResult, extended: Path
) -> None:
    (chain, film), old, card = fitted(), base.card, Model.load(extended).card
    assert_judged_alike(extended)  # by the monitor, as streaming and in a batch
    assert ModelEffect.from_card(card.effects[0]) == film
    assert card.structure["chain"]["constants"] == chain._asdict()
    assert card.input_names == (*NARX_INPUTS, "engine_speed_rpm", "coolant_temperature_degc")
    assert card.inputs[: len(old.inputs)] == old.inputs
    assert (card.lags, card.layers, card.kind) == (old.lags, old.layers, "narx")
    assert set(old.recordings) < set(card.recordings)
    assert ChainDifference.from_card(card).inputs[:2] == ("fuel_mass_mg", "air_mass_mg")
    assert [each["sha256"] for each in card.effects[0]["recordings"]] == ["ab" * 32]


def test_a_free_run_is_the_old_network_s_plus_the_chains_difference_by_numpy(
    base: FitResult, extended: Path
) -> None:
    driven = from_recording(gap_drives()[0])
    old, new = Model.load(base.path), Model.load(extended)
    difference = ChainDifference.from_card(new.card)
    part = difference.values(driven.signals)
    u_old, u_new = inputs_of(old, driven), inputs_of(new, driven)
    at, off = old.card.state.output_start, []
    old.reset(u_old[0])
    new.reset(u_new[0])
    for k in range(-difference.memory, 2000):  # the chains settle at the first sample
        old.step(u_old[max(k, 0)])
        new.step(u_new[max(k, 0)])
        off.append(float(new.state[0, at] - old.state[0, at]) - part[max(k, 0)])
    assert np.abs(off[difference.memory :]).max() < 1e-5
    assert np.ptp(part[:2000]) > 0.02


def test_a_measured_output_forces_the_network_without_the_effect_s_part(
    base: FitResult, extended: Path
) -> None:
    # GIVEN the old model in free run, and the new one with its state forced by old output plus part
    driven = from_recording(gap_drives()[0])
    old, new = Model.load(base.path), Model.load(extended)
    u_old, u_new = inputs_of(old, driven), inputs_of(new, driven)
    newest, part = old.card.state.output_start, old.card.state.size
    parts = []
    for k in range(1000):
        y = 0.95 + 0.05 * np.sin(k / 7.0)
        # THEN the network sees the same history in both, and predicts the same
        old.step(u_old[k])
        new.step(u_new[k])
        parts.append(float(new.state[0, part]))
        whole = float(old.state[0, newest]) + parts[-1]
        assert new.state[0, newest] == pytest.approx(whole, abs=1e-6)
        old.force_output(1.0 / y)
        new.force_output(1.0 / (y + parts[-1]))
    assert np.ptp(parts) > 0.02


def test_a_start_in_the_middle_of_a_drive_is_forgotten(base: FitResult, extended: Path) -> None:
    driven = from_recording(gap_drives()[0])
    through, late = Model.load(extended), Model.load(extended)
    u = inputs_of(through, driven)
    through.reset(u[0])
    apart = []
    for k, inputs in enumerate(u[:2500]):
        whole = through.step(inputs)
        if k == 1500:
            late.reset(inputs)
        if k >= 1500:
            apart.append(abs(1.0 / late.step(inputs) - 1.0 / whole))
    assert max(apart) > 0.003
    assert max(apart[300:]) < 0.001


def test_the_monitor_judges_with_a_network_that_has_any_effect_of_the_library(
    base: FitResult, tmp_path: Path
) -> None:
    # GIVEN a network with decision limits
    usual, settings = Model.load(shipped_model()).card.limits, config.load()
    path = tmp_path / "base.onnx"
    path.write_bytes(base.path.read_bytes())
    update_card(path, replace(base.card, limits=usual))
    driven = drive("us06", 2_020_140, duration_s=200.0, of_vehicle=2012)  # not of its training
    for effect in LIBRARY.values():
        # WHEN an effect is added, of which several read signals that the network does not
        added = ModelEffect.with_values(effect.name, [p.start[0] for p in effect.parameters])
        out = tmp_path / f"{effect.name}.onnx"
        add(path, [added], CHAIN, out, ranges=ranges(driven), recordings=FIT)
        # THEN the monitor judges with it
        model = Model.load(out)
        limits = Limits.from_card(model.card, settings, effect.name)
        (judged,) = judge_recordings([driven], model, limits, settings)
        assert judged.windows


def test_a_further_effect_is_added_to_a_model_that_has_one(
    base: FitResult, extended: Path, tmp_path: Path
) -> None:
    chain, film = fitted()
    more = ModelEffect.with_values("back_pressure", [1.0])
    seen = ranges(*gap_drives())
    twice, at_once = tmp_path / "twice.onnx", tmp_path / "at_once.onnx"
    card = add(extended, [more], chain, twice, ranges=seen, recordings=FIT)
    add(base.path, [film, more], chain, at_once, ranges=seen, recordings=FIT)
    assert [each["name"] for each in card.effects] == ["wall_film", "back_pressure"]
    recordings = gap_drives()[:1]
    (one,), (other,) = predicted_phi(twice, recordings), predicted_phi(at_once, recordings)
    assert np.array_equal(one, other)
    assert not np.array_equal(one, predicted_phi(extended, recordings)[0])


OFFSET = (LIBRARY["injector_offset"],)


def _case(*offsets_mg: float) -> Case:
    drives = [noisy_drive(1 + i, 0.003, "injector_offset", x) for i, x in enumerate(offsets_mg)]
    return replace(case_of(*drives), prior=(BASE, SPREAD_CARD))


def _plain(case: Case) -> tuple[JointFit, JointFit]:
    before = fit(case, (), [BASE])
    return before, fit(case, OFFSET, [before])


def test_a_drive_in_which_the_effect_is_many_times_as_strong_spoils_the_others_less() -> None:
    # GIVEN three drives with an effect, and one with ten times as much of it
    case = _case(0.3, 0.3, 3.0, 0.3)
    _, plain = _plain(case)
    # WHEN every drive counts by its own variance
    weighed, alike = fit_weighted(case, plain)
    # THEN the constant is near that of the three, and the fourth has the large errors
    assert plain.parameters[0][0] > 0.6
    assert alike.parameters[0][0] == pytest.approx(0.3, abs=0.1)
    assert int(np.argmax(weighed.scales)) == 2
    # AND drives that agree are fitted as by least squares
    case = _case(0.3, 0.3, 0.3)
    weighed, alike = fit_weighted(case, plain := _plain(case)[1])
    assert alike.parameters[0][0] == pytest.approx(plain.parameters[0][0], rel=1e-2)
    assert max(weighed.scales) < 1.1


@pytest.mark.parametrize(
    ("offsets_mg", "holds"),
    [
        ((0.3, 0.3, 0.3), True),  # the same in every drive
        ((0.3, 0.6, 0.2), True),  # of another size, but the same effect
        ((1.5, -1.5, 1.5, -1.5), False),  # another sign in every other drive
        ((0.3,), True),  # nothing to hold it against
    ],
)
def test_an_effect_is_kept_if_drives_left_out_are_predicted_better_with_it(
    offsets_mg: tuple[float, ...], holds: bool
) -> None:
    case = _case(*offsets_mg)
    before, plain = _plain(case)
    of = groups(len(case.drives))
    found = fit_and_leave_out(case, plain, of)
    assert (left_out_ratio(case, before, *found, of) < 1.0) is holds


def test_recordings_of_one_name_in_several_folders_are_each_held_against_their_own_prediction(
    base: FitResult,
) -> None:
    # GIVEN a network, and recordings of other lengths that their logger gave one name
    made = [drive("micro_trips", 2_020_131, FILM), drive("us06", 2_020_132, FILM, 300.0)]
    days = ("monday", "tuesday")
    alike = [replace(r, path=Path(day, "log1.log")) for r, day in zip(made, days, strict=True)]
    card, drives = base.card, list(map(from_recording, alike))
    subject = Subject(Material(base.path, alike), card, drives)
    case = Case(tuple(drives), tuple(np.zeros(len(each)) for each in drives))
    current = fit(case, (), [CHAIN])
    # THEN each has what the network predicts of it beyond the chain
    found, read = model_corrections(subject, case, current), predicted_phi(base.path, alike)
    for own, phi, driven in zip(found, read, drives, strict=True):
        assert own == pytest.approx(phi - phi_of(driven, current.base))
