"""Effects on fuel and charge before a network, on simulated drives with a hidden effect."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor.base.errors import ModelError, RecordingError
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.gap_networks import (
    CHAIN,
    FILM,
    FIT,
    assert_judged_alike,
    drive,
    fitted,
    gap_drives,
    healthy_drives,
    ranges,
    rmse,
    trained_on,
)
from training.gap.add import choice, network, network_parity
from training.gap.add.network import add, can_stand_before
from training.gap.add.network_before import CORRECTED, Before
from training.gap.add.network_graph import BEFORE, TO_OUTPUT, NetworkWithEffects
from training.gap.inputs.roles import Material, Options
from training.greybox.effects import ALL
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import Drive, from_recording
from training.greybox.graph.effect_parity import ParityError
from training.narx.export import update_card
from training.narx.fit import FitResult
from training.narx.model_file import HeldOut
from training.narx.parity import Parity
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording

RAIL = ("rail_exponent", 16.0)
NOTHING = ModelEffect.with_values("injector_offset", [0.0])


@pytest.fixture(scope="module")
def before(base: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The network with the film before it."""
    out = tmp_path_factory.mktemp("before") / "model.onnx"
    chain, film = fitted()
    add(
        base.path,
        [film],
        chain,
        out,
        ranges=ranges(*gap_drives()),
        recordings=FIT,
        drives=[from_recording(gap_drives()[1])],
        form=BEFORE,
    )
    return out


def test_the_hidden_film_s_gap_shrinks_on_a_drive_no_fit_saw(base: FitResult, before: Path) -> None:
    fresh = drive("udds", 2_020_130, FILM)
    old, new = (
        rmse(predicted_phi(path, [fresh])[0], from_recording(fresh)) for path in (base.path, before)
    )
    assert new < 0.5 * old


def test_a_network_far_outside_its_training_is_brought_back_into_it(
    base: FitResult, tmp_path: Path
) -> None:
    # GIVEN a rail pressure that acts so much otherwise that the controller leaves its usual range
    recordings, (chain, rail) = gap_drives(RAIL), fitted(RAIL)
    known = {channel.name: channel for channel in base.card.inputs}["lambda_controller"]
    assert ranges(*recordings)["lambda_controller"][1] > known.maximum
    # WHEN the effect is added to the output, and before the network
    for form in (TO_OUTPUT, BEFORE):
        out = tmp_path / f"{form}.onnx"
        add(base.path, [rail], chain, out, ranges=ranges(*recordings), recordings=FIT, form=form)
    # THEN the network that reads what it was trained on errs less
    fresh = [
        drive(cycle, seed, RAIL)
        for cycle, seed in (("micro_trips", 2_020_133), ("us06", 2_020_134), ("udds", 2_020_136))
    ]
    output, before = (
        [
            rmse(phi, from_recording(each))
            for phi, each in zip(
                predicted_phi(tmp_path / f"{form}.onnx", fresh), fresh, strict=True
            )
        ]
        for form in (TO_OUTPUT, BEFORE)
    )
    assert (np.array(before) < 0.95 * np.array(output)).all()


def test_the_card_takes_the_fuel_as_it_is_broadcast(base: FitResult, before: Path) -> None:
    card, seen = Model.load(before).card, ranges(*gap_drives())
    assert card.structure["form"] == BEFORE
    assert card.effects[0]["name"] == "wall_film"
    old = {channel.name: channel for channel in base.card.inputs}
    for channel in card.inputs:
        if channel.name in CORRECTED:
            assert channel.minimum <= min(seen[channel.name][0], old[channel.name].minimum)
            assert channel.maximum >= max(seen[channel.name][1], old[channel.name].maximum)
        elif channel.name in old:
            assert channel == old[channel.name]
    found = card.checks["parity"]
    assert found["samples"] > 2900
    assert max(found["onnx_numpy"], found["torch_numpy"]) < 1e-4 < found["tolerance"]


def test_an_effect_of_size_zero_changes_nothing_but_roundings(
    base: FitResult, tmp_path: Path
) -> None:
    out = tmp_path / "model.onnx"
    add(base.path, [NOTHING], CHAIN, out, ranges=ranges(*gap_drives()), recordings=FIT, form=BEFORE)
    recordings = gap_drives()[:2]
    for old, new in zip(
        predicted_phi(base.path, recordings), predicted_phi(out, recordings), strict=True
    ):
        assert np.abs(old - new).max() < 1e-4


def test_the_monitor_judges_it_as_streaming_and_in_a_batch(before: Path) -> None:
    assert_judged_alike(before)


def test_a_file_that_computes_something_else_is_refused(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = Before.values
    monkeypatch.setattr(
        Before, "values", lambda self, s: {k: 1.02 * x for k, x in right(self, s).items()}
    )
    with pytest.raises(ModelError, match="free runs differ"):
        add(
            base.path,
            [NOTHING],
            CHAIN,
            tmp_path / "model.onnx",
            ranges=ranges(*gap_drives()),
            recordings=FIT,
            form=BEFORE,
        )
    assert not list(tmp_path.iterdir())


def test_only_what_acts_on_fuel_and_charge_may_stand_before_a_network(base: FitResult) -> None:
    driven = from_recording(gap_drives()[0])
    may = {
        effect.name
        for effect in ALL
        if can_stand_before(
            base.path,
            [ModelEffect.with_values(effect.name, [p.start[0] for p in effect.parameters])],
            CHAIN,
            driven,
        )
    }
    assert may == {
        "wall_film",
        "injector_offset",
        "rail_exponent",
        "purge",
        "ethanol",
        "maf_offset",
        "maf_pulsation",
        "scavenging",
        "charge_temperature",
        "manifold_filling",
    }


def test_an_effect_of_the_exhaust_takes_what_stood_before_the_network_to_its_output(
    base: FitResult, before: Path, tmp_path: Path
) -> None:
    chain, film = fitted()
    more, seen = ModelEffect.with_values("back_pressure", [1.0]), ranges(*gap_drives())
    assert not can_stand_before(before, [more], chain, from_recording(gap_drives()[0]))
    twice, at_once = tmp_path / "twice.onnx", tmp_path / "at_once.onnx"
    card = add(before, [more], chain, twice, ranges=seen, recordings=FIT)
    add(base.path, [film, more], chain, at_once, ranges=seen, recordings=FIT)
    assert [each["name"] for each in card.effects] == ["wall_film", "back_pressure"]
    (one,), (other,) = (predicted_phi(path, gap_drives()[:1]) for path in (twice, at_once))
    assert np.array_equal(one, other)


@pytest.mark.parametrize("wrong", [BEFORE, TO_OUTPUT])
def test_a_form_that_fails_its_proof_is_left_out(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    # GIVEN a form in which ONNX and numpy differ, as they may where a network amplifies roundings
    chain, film = fitted()
    material = Material(base.path, gap_drives(), verify=gap_drives()[:1])
    right = network_parity.parity

    def parity(path: Path, model: NetworkWithEffects, drives: Sequence[Drive]) -> Parity:
        if model.form == wrong:
            raise ParityError("they differ")
        return right(path, model, drives)

    monkeypatch.setattr(network_parity, "parity", parity)
    # WHEN the film is added THEN the other form is taken, and no other file is left
    target = tmp_path / "model.onnx"
    new, form, added = choice.add(
        material, target, choices=[[film]], known=None, start=chain, options=Options()
    )
    assert new is not None
    assert added == (film,)
    assert form.startswith("beside the network" if wrong == BEFORE else "before the network")
    assert list(tmp_path.iterdir()) == [new]
    # and with none that agrees nothing is
    monkeypatch.setattr(choice.network, "can_stand_before", lambda *_: wrong == BEFORE)
    monkeypatch.setattr(network_parity, "parity", _differ)
    with pytest.raises(ParityError, match="they differ"):
        choice.add(
            material,
            tmp_path / "other.onnx",
            choices=[[film]],
            known=None,
            start=chain,
            options=Options(),
        )
    assert list(tmp_path.iterdir()) == [new]


def test_of_several_constants_those_that_predict_best_are_taken(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a film with constants that were fitted, and with others, in one form
    monkeypatch.setattr(network, "can_stand_before", lambda *_: False)
    chain, film = fitted()
    far = ModelEffect.with_values("wall_film", [2.0 * film.values[0], *film.values[1:].tolist()])
    material = Material(base.path, gap_drives(), verify=gap_drives()[:1])
    for choices in ([[far], [film]], [[film], [far]]):
        # WHEN it is added THEN the better ones are taken, whichever come first
        _, _, added = choice.add(
            material,
            tmp_path / "m.onnx",
            choices=choices,
            known=None,
            start=chain,
            options=Options(),
        )
        assert added == (film,)
    assert [each.name for each in tmp_path.iterdir()] == ["m.onnx"]


@pytest.mark.parametrize(
    ("trained", "begins"),
    [("far", "beside the network"), ("near", "as one more input of the network")],
)
def test_a_network_trained_anew_is_kept_only_if_it_predicts_better(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trained: str, begins: str
) -> None:
    # GIVEN training that ends in a network that is worse or better than the effect beside the old
    monkeypatch.setattr(network, "can_stand_before", lambda *_: False)
    chain, film = fitted()
    drives = gap_drives()
    material, target = Material(base.path, drives, verify=drives[:1]), tmp_path / "m.onnx"
    far, further = (
        ModelEffect.with_values("wall_film", [size * film.values[0], *film.values[1:].tolist()])
        for size in (1.2, 1.5)
    )

    def retrain(*given_as: Any, **__: object) -> tuple[HeldOut, ...]:
        values = film if trained == "near" else further
        beside, _, _ = choice.add(
            material,
            tmp_path / "r" / "m.onnx",
            choices=[[values]],
            known=None,
            start=chain,
            options=Options(),
        )
        assert beside is not None
        beside.replace(given_as[4])
        beside.parent.rmdir()
        return ()

    monkeypatch.setattr(network, "retrain", retrain)
    # WHEN either may be taken
    options = Options(retrain_minutes=1.0)
    new, form, _ = choice.add(
        material, target, choices=[[far]], known=None, start=chain, options=options
    )
    # THEN it is the better one, and the other's file is gone
    assert new == target
    assert form.startswith(begins)
    assert list(tmp_path.iterdir()) == [target]
    # and of one that fails its proof it is said
    monkeypatch.setattr(network, "retrain", _differ)
    _, form, _ = choice.add(
        material, target, choices=[[far]], known=None, start=chain, options=options
    )
    assert form.startswith("beside the network")
    assert form.endswith("; not trained anew: they differ")


def test_a_network_that_follows_the_film_is_trained_anew_with_healthy_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def limits(
        _: Model, recordings: Sequence[Recording], held_out: Sequence[HeldOut], *rest: object
    ) -> None:
        blocks[:] = held_out
        assert list(recordings) == list(gap_drives()[:2])
        assert rest[-1] == choice.HELD_OUT_BLOCKS
        raise RecordingError("too few windows")

    blocks: list[HeldOut] = []
    monkeypatch.setattr(choice, "with_limits", limits)
    # GIVEN a network trained on drives with the film
    chain, film = fitted()
    follows = trained_on(gap_drives()[:2], tmp_path)
    own = Model.load(shipped_model()).card.limits
    update_card(follows.path, replace(follows.card, limits=own))
    material = Material(follows.path, gap_drives()[:2], healthy_drives(), verify=gap_drives()[2:])
    out = tmp_path / "m.onnx"
    # WHEN it may be trained anew, on healthy drives too, on which the film changes nothing
    new, form, _ = choice.add(
        material,
        out,
        choices=[[film]],
        known=None,
        start=chain,
        options=Options(retrain_minutes=1.0),
    )
    # THEN it predicts far better what no fit saw
    assert new == out
    assert form.startswith("as one more input of the network, trained anew")
    card = Model.load(out).card
    assert {each.sha256 for each in healthy_drives()} < {each.sha256 for each in card.recordings}
    # AND limits are set on what its training held out of the drives with the film
    assert {each.recording for each in blocks} == {0, 1}
    assert sum(each.stop - each.first for each in blocks) < 4000
    fresh = drive("udds", 2_020_130, FILM)
    before, after = (
        rmse(predicted_phi(path, [fresh])[0], from_recording(fresh)) for path in (follows.path, out)
    )
    assert after < 0.5 * before


@pytest.mark.parametrize("knows", [False, True])
def test_the_old_model_is_judged_on_recordings_that_it_does_not_know(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, knows: bool
) -> None:
    # GIVEN constants from recordings on which the old network was trained, or not
    chain, film = fitted()
    fitted_to = (healthy_drives() if knows else gap_drives())[:2]
    unseen, seen = gap_drives()[2], healthy_drives()[2]
    material = Material(base.path, fitted_to, verify=[unseen, seen])
    judged = list[tuple[Recording, ...]]()

    def error(_: Path, recordings: Sequence[Recording]) -> float:
        judged.append(tuple(recordings))
        return float(len(judged))

    monkeypatch.setattr(choice, "_rmse", error)
    # WHEN old and new model are held against each other THEN it is on those that it does not know
    choice.add(
        material, tmp_path / "m.onnx", choices=[[film]], known=None, start=chain, options=Options()
    )
    assert judged == len(judged) * [(unseen,) if knows else fitted_to]
    assert len(judged) >= 2


def _differ(*_: object, **__: object) -> Parity:
    raise ParityError("they differ")
