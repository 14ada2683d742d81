"""The new model's file: constants and forms beside a network, on drives with a hidden effect."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from monitor.base.errors import RecordingError
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.gap.gap_networks import (
    FILM,
    drive,
    fitted,
    gap_drives,
    healthy_drives,
    rmse,
    trained_on,
)
from training.gap.add import choice, network, network_parity
from training.gap.add.network_graph import NetworkWithEffects
from training.gap.add.network_parity import ParityError
from training.gap.inputs.roles import GapOptions, Material
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive, from_recording
from training.narx.export import update_card
from training.narx.fit import FitResult
from training.narx.model_file import HeldOut
from training.narx.parity import Parity
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording


def added_to(
    material: Material, out: Path, *constants: ModelEffect, minutes: float = 0.0
) -> tuple[Path | None, str, tuple[ModelEffect, ...]]:
    """Add the film with the best of several constants, or train anew with it."""
    return choice.add(
        material,
        out,
        choices=[[each] for each in constants],
        known=None,
        start=fitted()[0],
        options=GapOptions(retrain_minutes=minutes),
    )


def test_constants_that_fail_their_proof_are_left_out(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN constants with which ONNX and numpy differ, as they may where roundings are amplified
    _, film = fitted()
    other = ModelEffect.with_values("wall_film", [0.5 * film.values[0], *film.values[1:].tolist()])
    material = Material(base.path, gap_drives(), verify=gap_drives()[:1])
    right = network_parity.parity

    def parity(path: Path, model: NetworkWithEffects, drives: Sequence[ChainDrive]) -> Parity:
        if model.difference.entries[0].added == film:
            raise ParityError("they differ")
        return right(path, model, drives)

    monkeypatch.setattr(network, "parity", parity)
    # WHEN the film is added THEN the others are taken, and no other file is left
    target = tmp_path / "model.onnx"
    new, form, added = added_to(material, target, film, other)
    assert new is not None
    assert added == (other,)
    assert form.startswith("beside the network")
    assert list(tmp_path.iterdir()) == [new]
    # and with none that agrees nothing is
    monkeypatch.setattr(network, "parity", _differ)
    with pytest.raises(ParityError, match="they differ"):
        added_to(material, tmp_path / "other.onnx", film)
    assert list(tmp_path.iterdir()) == [new]


def test_of_several_constants_those_that_predict_best_are_taken(
    base: FitResult, tmp_path: Path
) -> None:
    # GIVEN a film with constants that were fitted, and with others, in one form
    _, film = fitted()
    far = ModelEffect.with_values("wall_film", [2.0 * film.values[0], *film.values[1:].tolist()])
    material = Material(base.path, gap_drives(), verify=gap_drives()[:1])
    for choices in ((far, film), (film, far)):
        # WHEN it is added THEN the better ones are taken, whichever come first
        _, _, added = added_to(material, tmp_path / "m.onnx", *choices)
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
    _, film = fitted()
    drives, target = gap_drives(), tmp_path / "m.onnx"
    material = Material(base.path, drives, verify=drives[:1])
    far, further = (
        ModelEffect.with_values("wall_film", [size * film.values[0], *film.values[1:].tolist()])
        for size in (1.2, 1.5)
    )

    def retrain(*given_as: Any, **__: object) -> tuple[HeldOut, ...]:
        values = film if trained == "near" else further
        beside, _, _ = added_to(material, tmp_path / "r" / "m.onnx", values)
        assert beside is not None
        beside.replace(given_as[4])
        beside.parent.rmdir()
        return ()

    monkeypatch.setattr(network, "retrain", retrain)
    # WHEN either may be taken
    new, form, _ = added_to(material, target, far, minutes=0.05)
    # THEN it is the better one, and the other's file is gone
    assert new == target
    assert form.startswith(begins)
    assert list(tmp_path.iterdir()) == [target]
    # and of one that fails its proof it is said
    monkeypatch.setattr(network, "retrain", _differ)
    _, form, _ = added_to(material, target, far, minutes=0.05)
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
    _, film = fitted()
    follows = trained_on(gap_drives()[:2], tmp_path)
    own = Model.load(shipped_model()).card.limits
    update_card(follows.path, replace(follows.card, limits=own))
    material = Material(follows.path, gap_drives()[:2], healthy_drives(), verify=gap_drives()[2:])
    out = tmp_path / "m.onnx"
    # WHEN it may be trained anew, on healthy drives too, on which the film changes nothing
    new, form, _ = added_to(material, out, film, minutes=0.05)
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
    _, film = fitted()
    fitted_to = (healthy_drives() if knows else gap_drives())[:2]
    unseen, seen = gap_drives()[2], healthy_drives()[2]
    material = Material(base.path, fitted_to, verify=[unseen, seen])
    judged = list[tuple[Recording, ...]]()

    def error(_: Path, recordings: Sequence[Recording]) -> float:
        judged.append(tuple(recordings))
        return float(len(judged))

    monkeypatch.setattr(choice, "_rmse", error)
    # WHEN old and new model are held against each other THEN it is on those that it does not know
    added_to(material, tmp_path / "m.onnx", film)
    assert judged == len(judged) * [(unseen,) if knows else fitted_to]
    assert len(judged) >= 2


def _differ(*_: object, **__: object) -> Parity:
    raise ParityError("they differ")
