"""The healthy reference in the model card: as good as the healthy recordings, and carried on."""

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.workflow import drive
from benchmarks.studies.workflow.plan import Part
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from training.gap.inputs import suitability
from training.gap.inputs.roles import GapOptions, Material
from training.gap.inputs.subject import Subject
from training.gap.name.knowledge import Knowledge
from training.gap.result import Result
from training.gap.workflow import investigate
from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY
from training.greybox.fit.case import reading
from training.greybox.fit.drive import from_recording
from training.greybox.graph.chain_graph import Greybox
from training.greybox.model import fit_greybox
from training.healthy import base, yardstick
from training.healthy.behaviour import Healthy, as_shown
from training.healthy.card import KEY, from_card, known_of, store, to_card
from training.healthy.new_model import set_reference
from training.narx.export import update_card
from training.recordings.recording import Recording

VEHICLE = 2011
HEALTHY = ("wltc_3b", "micro_trips", "udds", "us06")
FEW = 3  # healthy drives that can be held against each other
DRIVEN = ("micro_trips", "wltc_3b")
FILM = {"wall_film": 8.0}  # in which the library's form leaves more than healthy drives differ


@cache
def recordings(
    seed: int, cycles: tuple[str, ...] = DRIVEN, seconds: float = 400.0, **effects: float
) -> tuple[Recording, ...]:
    """Return the beginning of each cycle."""
    parts = [Part(cycle, seed + i, 0.0, None) for i, cycle in enumerate(cycles)]
    return tuple(drive.recording(part, VEHICLE, seconds, effects, None) for part in parts)


@cache
def fitted() -> bytes:
    """Return the file of a grey-box model of the healthy drives."""
    with TemporaryDirectory() as folder:
        found = fit_greybox(recordings(2_310_000, HEALTHY), Path(folder) / "m.onnx")
        return found.path.read_bytes()


@cache
def known() -> Healthy:
    """Return what healthy drives teach of the chain, with the charge that it makes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "m.onnx"
        path.write_bytes(fitted())
        drives = base.drives_of(path, recordings(2_310_000, HEALTHY))
    return yardstick.learn(drives, Constants())


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a grey-box model file with a reference in its card."""
    path = tmp_path_factory.mktemp("chain") / "chain.onnx"
    path.write_bytes(fitted())
    store(path, known(), recordings(2_310_000, HEALTHY))
    return path


@pytest.fixture(scope="module")
def alone(chain: Path, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """Give what is found of a hidden effect without healthy recordings."""
    return asked(chain, recordings(2_311_000, **FILM), tmp_path_factory.mktemp("alone"))


def asked(model: Path, seen: tuple[Recording, ...], out: Path, **healthy: Any) -> Result:
    """Return what the workflow says, quickly."""
    options = GapOptions(faults=())
    material = Material(model, seen, healthy.get("healthy", ()))
    return investigate(material, out, options, known=healthy.get("known"))


def test_the_reference_in_a_model_file_corrects_drives_as_what_was_learned(chain: Path) -> None:
    read, doubts = from_card(Model.load(chain).card)
    assert doubts is None
    assert read is not None
    for recording in (*recordings(2_310_000, HEALTHY), *recordings(2_311_000, **FILM)):
        (driven,) = base.drives_of(chain, [recording])
        learned = known().correction(driven)
        assert np.abs(learned).max() > 1e-3
        assert np.abs(read.correction(driven) - learned).max() < 2e-6
        assert (read.known_of(driven).scored == known().known_of(driven).scored).all()
    assert read.spread == pytest.approx(known().spread, rel=1e-6)
    assert read.surplus == pytest.approx(known().surplus, rel=1e-6)
    assert read.rmse_usual == pytest.approx(known().rmse_usual, rel=1e-6)


def test_without_healthy_recordings_an_effect_is_named_as_with_them(
    chain: Path, alone: Result, tmp_path: Path
) -> None:
    # GIVEN drives with a hidden effect
    driven, healthy = recordings(2_311_000, **FILM), recordings(2_310_000, HEALTHY)[::-1]
    # WHEN it is looked for with the healthy recordings, and with the model's own reference
    given = asked(chain, driven, tmp_path, healthy=healthy, known=known())
    # THEN the answer is the same, but for what the report says of the drives that are not there
    for found in (given, alone):
        assert (found.verdict, [a.name for a in found.addition.effects]) == ("named", ["wall_film"])
    for name, value in given.addition.effects[0].parameters.items():
        # the card's reference is of the chain with the vehicle's own volumes, not of it alone
        assert alone.addition.effects[0].parameters[name] == pytest.approx(value, rel=0.1)
    assert alone.naming.base.reference == pytest.approx(known().base, rel=1e-5)
    (text,) = (w for w in alone.all_warnings if "no healthy recordings were given" in w)
    assert "of 4 recordings" in text
    assert not any("no healthy recordings" in w for w in given.all_warnings)
    # AND the new model has the reference with which its constants go
    assert given.addition.path is not None
    stored = Model.load(given.addition.path).card.reference[KEY]
    assert stored["recordings"] == [each.path.name for each in healthy]


def test_a_model_fitted_to_drives_with_the_effect_gets_the_charge_of_healthy_ones(
    tmp_path: Path,
) -> None:
    # GIVEN a chain fitted to drives with a hidden effect, which its error of the charge takes in
    driven, healthy = recordings(2_311_000, purge=8.0), recordings(2_310_000, HEALTHY)[:FEW]
    model = fit_greybox(driven, tmp_path / "m.onnx").path
    assert [each.charged for each in base.drives_of(model, driven)] == [True, True]
    # WHEN healthy drives are given
    made = base.drives_of(model, driven, healthy)
    known = yardstick.learn(base.drives_of(model, healthy, healthy), Constants())
    found = asked(model, driven, tmp_path, healthy=healthy, known=known)
    # THEN the effect is looked for beside the charge that these teach, and both go into the model
    assert [each.charged for each in made] == [False, False]
    np.testing.assert_array_equal(made[0].signals["air_mass_mg"], driven[0].column("air_mass_mg"))
    assert (found.verdict, [a.name for a in found.addition.effects]) == ("named", ["purge"])
    assert found.addition.path is not None
    new = Greybox.of(Model.load(found.addition.path).card)
    assert known.charge is not None
    assert new.charge is not None
    assert new.charge.to_card() == known.charge.to_card()
    # AND a recording that no fit saw is predicted far better
    before, after, _, _ = found.rmse
    assert after is not None
    assert after < 0.7 * before


def test_walls_that_a_model_has_taken_in_are_named_and_not_added_again(tmp_path: Path) -> None:
    # GIVEN a chain fitted to drives with walls, which are part of it then
    driven = recordings(2_311_000, seconds=600.0, **FILM)
    healthy = recordings(2_310_000, HEALTHY[:FEW], seconds=600.0)
    fitted = fit_greybox(driven, tmp_path / "m.onnx")
    assert [own.name for own in fitted.greybox.own] == ["wall_film"]
    # WHEN healthy drives without them are given
    found = asked(fitted.path, driven, tmp_path, healthy=healthy)
    # THEN they are what is new, and nothing is to be added
    assert [each.name for each in found.naming.answer.effects] == ["wall_film"]
    assert found.addition.path is None
    assert any("follows the effect already" in each for each in found.all_warnings)


def test_recordings_that_the_model_was_fitted_to_are_told_from_others(chain: Path) -> None:
    card = Model.load(chain).card
    driven, one = recordings(2_311_000, **FILM), recordings(2_310_000, HEALTHY)[1:2]
    assert suitability.seen_in_fit_warnings(card, Material(chain, driven)) == []
    for given in ((driven + one,), (driven, (), one), (one, one)):
        (warning,) = suitability.seen_in_fit_warnings(card, Material(chain, *given))
        assert warning.startswith(f"{one[0].path.name}: the model was fitted to them")
        assert ("counts as healthy" in warning) == (given[0] != one)


def test_two_healthy_recordings_are_said_not_to_tell_how_healthy_drives_differ(chain: Path) -> None:
    driven, healthy = recordings(2_311_000, **FILM), recordings(2_310_000, HEALTHY)[:2]
    given = Subject.of(Material(chain, driven, healthy), Model.load(chain).card)
    (doubt,) = Knowledge.of(given, None, lambda _: None).doubts
    assert doubt.startswith("fewer than 3 healthy recordings")


def test_a_model_extended_without_healthy_recordings_has_no_gap_left(
    chain: Path, alone: Result, tmp_path: Path
) -> None:
    assert alone.addition.path is not None
    card = Model.load(alone.addition.path).card
    assert card.reference[KEY] == Model.load(chain).card.reference[KEY]
    assert base.constants_of(card) == pytest.approx(known().base, rel=1e-5)
    own = {each.name: each.values for each in Greybox.of(card).own}
    assert own == {each.name: pytest.approx(each.values, rel=1e-5) for each in known().own}
    again = asked(alone.addition.path, recordings(2_311_000, **FILM), tmp_path)
    assert again.verdict == "no_gap"


def test_what_an_extended_model_has_is_asked_of_healthy_drives_that_show_it(alone: Result) -> None:
    # GIVEN drives with a wall film, without, and how far it moves the chain on each
    start = known().base
    shown, not_shown = (
        [from_recording(each) for each in recordings(seed, **hidden)]
        for seed, hidden in ((2_311_000, FILM), (2_313_000, {}))
    )
    film, amounts = LIBRARY["wall_film"], np.array([*alone.addition.effects[0].parameters.values()])
    yes, no = [True] * len(DRIVEN), [False] * len(DRIVEN)
    for drives, stays in ((shown, yes), (not_shown, no), (shown + not_shown, yes + no)):
        moved = [
            replace(d, moved_phi=reading(d, start, (film,), (amounts,)) - reading(d, start, (), ()))
            for d in drives
        ]
        # THEN it counts where the drives have it, and nowhere else
        assert [bool(np.any(d.moved_phi)) for d in as_shown(moved, start)] == stays
        assert as_shown(drives, start) is drives


def test_a_network_has_the_reference_of_the_chain_and_keeps_it(tmp_path: Path) -> None:
    # GIVEN a network of another vehicle, with this vehicle's reference
    network = tmp_path / "network.onnx"
    shutil.copy(shipped_model(), network)
    store(network, known(), recordings(2_310_000, HEALTHY))
    # WHEN an effect is hidden
    found = asked(network, recordings(2_311_000, **FILM), tmp_path / "first")
    # THEN it alone is named, not what the network makes wrong on this vehicle
    assert (found.verdict, [a.name for a in found.addition.effects]) == ("named", ["wall_film"])
    assert any("what the network alone makes wrong" in w for w in found.all_warnings)
    # AND the network with it has this gap no longer
    assert found.addition.path is not None
    again = asked(found.addition.path, recordings(2_311_000, **FILM), tmp_path / "again")
    assert "wall_film" not in [e.name for e in again.naming.answer.effects]
    assert again.rmse[0] < 0.7 * found.rmse[0]


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ({"schema": "o2train.gap_reference/0"}, "has schema 'o2train.gap_reference/0'"),
        ({"columns": "renamed"}, "columns of other code: tyre pressure"),
        ({"weight": [1.0]}, "cannot be read"),
        ({"base": {"gain": 1.0}}, "cannot be read"),
        ({"visited": {"cells": ["01"], "coolants": "0111"}}, "cannot be read"),
    ],
)
def test_a_reference_of_other_code_is_left_out(broken: dict[str, Any], words: str) -> None:
    stored = to_card(known(), recordings(2_310_000, HEALTHY))
    if "columns" in broken:
        broken = {"columns": ["tyre pressure", *stored["columns"][1:]]}
    card = with_reference(stored | broken)
    assert from_card(with_reference(stored))[1] is None
    read, why = from_card(card)
    assert read is None
    assert why is not None
    assert words in why
    assert known_of(card) == (None, [why])


def with_reference(stored: dict[str, Any]) -> ModelCard:
    return replace(Model.load(shipped_model()).card, reference={KEY: stored})


def test_a_card_without_a_reference_says_nothing() -> None:
    card = replace(Model.load(shipped_model()).card, reference={})
    assert from_card(card) == (None, None)
    assert known_of(card) == (None, [])


def test_an_effect_goes_with_the_constants_that_it_was_fitted_beside(
    chain: Path, tmp_path: Path
) -> None:
    # GIVEN a chain of which nothing holds the constants
    card, bare = Model.load(chain).card, tmp_path / "bare.onnx"
    update_card(chain, replace(card, reference={}), bare)
    # WHEN an effect is added to it, THEN its constants move with the effect
    added = asked(bare, recordings(2_311_000, **FILM), tmp_path).addition.path
    assert added is not None
    assert base.constants_of(Model.load(added).card) != base.constants_of(card)


def test_too_few_recordings_teach_nothing_and_say_so(chain: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.onnx"
    shutil.copy(chain, bare)
    update_card(bare, replace(Model.load(bare).card, reference={}))
    two, short = recordings(2_310_000, HEALTHY)[:2], recordings(2_313_000)[0]
    short = replace(
        short, values=short.values[:300], quality=short.quality[:300], t_s=short.t_s[:300]
    )
    card, warning = set_reference(bare, [*two, short])
    assert KEY not in card.reference
    assert warning is not None
    assert "2 of 3 recordings can be used, 3 are wanted" in warning
    assert "s can be scored" in warning
