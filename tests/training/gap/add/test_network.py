"""Effects added in the network's graph, on simulated drives of which one has a hidden effect."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.base import config
from monitor.base.errors import ModelError, RecordingError, UsageError
from monitor.base.signals import NARX_INPUTS, OUTPUT
from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.model.step import Model, from_model_units
from monitor.pipeline.replay import shipped_model
from tests.helpers.gap.gap_networks import (
    CHAIN,
    FILM,
    FIT,
    assert_judged_alike,
    drive,
    fitted,
    gap_drives,
    healthy_drives,
    inputs_of,
    ranges,
    rmse,
)
from training.gap.add.network import add, retrain
from training.gap.add.network_graph import AS_INPUT, DIFFERENCE, TO_OUTPUT, network_of
from training.gap.add.network_training import old_weights, spec_of, with_difference
from training.greybox.effects import ALL
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive, from_recording
from training.greybox.graph.chain_difference import ChainDifference
from training.limits.evaluation import predict
from training.limits.judging import judge_recordings
from training.narx.export import Network, save, update_card
from training.narx.fit import FitResult
from training.narx.network import Spec
from training.narx.network import simulate as run_network
from training.narx.search.mean import mean_of
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, prepare

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


def test_the_free_run_goes_on_over_inputs_that_are_missing() -> None:
    whole = drive("wltc_3b", 2_020_101)
    gap = slice(1000, 1030)
    (held,) = predicted_phi(shipped_model(), [without(whole, gap, "maf_kg_h")])
    (phi,) = predicted_phi(shipped_model(), [whole])
    assert np.isfinite(held).all()
    assert np.array_equal(held[:1000], phi[:1000])
    assert not np.array_equal(held[gap], phi[gap])
    assert np.abs(held - phi)[1100:].max() < 1e-5


def test_a_signal_that_is_never_good_is_refused() -> None:
    missing = without(drive("wltc_3b", 2_020_101), slice(None), "maf_kg_h")
    with pytest.raises(RecordingError, match="maf_kg_h is never good"):
        predicted_phi(shipped_model(), [missing])


def again(card: ModelCard, old: Network, data: Prepared) -> tuple[Spec, FloatArray]:
    spec = spec_of(card, old, data)
    return spec, old_weights(old, spec, data.scaling)


def free(network: Network, u: FloatArray) -> FloatArray:
    """Return the free run in phi after a history of 1."""
    spec, scale, first = network.spec, network.scaling, network.spec.memory
    history = np.full((1, spec.lags), float(scale.scale_y(1.0)))
    begin, end = np.array([first]), np.array([len(u)])
    run = run_network(
        spec, network.weights, u=scale.scale_u(u), start=begin, stop=end, history=history
    )
    return scale.unscale_y(run)[first:]


def proof() -> list[ChainDrive]:
    """Return the drive on which ONNX and numpy must agree."""
    return [from_recording(gap_drives()[1])]


@pytest.fixture(scope="module")
def extended(base: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("added") / "model.onnx"
    chain, film = fitted()
    add(
        base.path,
        [film],
        chain,
        out,
        ranges=ranges(*gap_drives()),
        recordings=FIT,
        drives=proof(),
    )
    return out


@pytest.fixture(scope="module")
def retrained(base: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("retrained") / "model.onnx"
    chain, film = fitted()
    held_out = retrain(
        base.path,
        [film],
        chain,
        gap_drives(),
        out,
        ranges=ranges(*gap_drives()),
        healthy=healthy_drives()[:1],
        budget_minutes=0.05,
    )
    # Limits may be set on blocks of drives with the film alone: on others the model is wrong.
    assert {each.recording for each in held_out} == {0, 1, 2}
    return out


def test_an_effect_of_size_zero_changes_no_bit(base: FitResult, tmp_path: Path) -> None:
    out = tmp_path / "model.onnx"
    add(
        base.path,
        [NOTHING],
        CHAIN,
        out,
        ranges=ranges(*gap_drives()),
        recordings=FIT,
        drives=proof(),
    )
    recordings = gap_drives()[:2]
    for old, new in zip(
        predicted_phi(base.path, recordings), predicted_phi(out, recordings), strict=True
    ):
        assert np.array_equal(old, new)


def test_a_network_of_its_usual_inputs_needs_no_engine_speed_for_an_effect(
    base: FitResult, tmp_path: Path
) -> None:
    # GIVEN drives on which nobody broadcasts the engine speed, and a film, which is per stroke
    chain, film = fitted()
    seen = ranges(*gap_drives())
    del seen["engine_speed_rpm"]
    out = tmp_path / "model.onnx"
    # WHEN it is added
    card = add(base.path, [film], chain, out, ranges=seen, recordings=FIT, drives=proof())
    # THEN the file does not ask for it, and predicts better, though this ECU's charge follows its
    # air meter slowly, so that the speed worked out of both is wrong in transients
    assert card.input_names == (*NARX_INPUTS, "coolant_temperature_degc")
    fresh = drive("udds", 2_020_130, FILM)
    before, after = (
        rmse(predicted_phi(path, [fresh])[0], from_recording(fresh)) for path in (base.path, out)
    )
    assert after < 0.95 * before


def test_the_hidden_film_s_gap_shrinks_on_a_drive_no_fit_saw(
    base: FitResult, extended: Path, retrained: Path
) -> None:
    fresh = drive("udds", 2_020_130, FILM)
    before, added, again = (
        rmse(predicted_phi(path, [fresh])[0], from_recording(fresh))
        for path in (base.path, extended, retrained)
    )
    assert added < 0.5 * before
    assert again < 0.6 * before


def test_the_card_says_what_was_added_and_where_it_came_from(
    base: FitResult, extended: Path, retrained: Path
) -> None:
    chain, film = fitted()
    old = base.card
    for path, form in ((extended, TO_OUTPUT), (retrained, AS_INPUT)):
        card = Model.load(path).card
        assert ModelEffect.from_card(card.effects[0]) == film
        assert card.structure["form"] == form
        assert card.structure["chain"]["constants"] == chain._asdict()
        assert card.input_names == (*NARX_INPUTS, "engine_speed_rpm", "coolant_temperature_degc")
        assert card.inputs[: len(old.inputs)] == old.inputs
        assert (card.lags, card.layers, card.kind) == (old.lags, old.layers, "narx")
        assert set(old.recordings) < set(card.recordings)
        assert ChainDifference.from_card(card).inputs[:2] == ("fuel_mass_mg", "air_mass_mg")
    came_from = Model.load(extended).card.effects[0]["recordings"]
    assert [each["sha256"] for each in came_from] == ["ab" * 32]
    # of a network trained anew they are drives with the film alone, though healthy ones take part
    card = Model.load(retrained).card
    came_from = card.effects[0]["recordings"]
    assert [each["sha256"] for each in came_from] == [each.sha256 for each in gap_drives()]
    assert healthy_drives()[0].sha256 in [each.sha256 for each in card.recordings]


@pytest.mark.parametrize("which", ["extended", "retrained"])
def test_onnx_and_numpy_agree_on_drives(
    which: str, base: FitResult, request: pytest.FixtureRequest
) -> None:
    card = Model.load(request.getfixturevalue(which)).card
    found = card.checks["parity"]
    assert found["samples"] > 2900
    assert found["onnx_numpy"] < 1e-4 < found["tolerance"]


def test_a_file_that_computes_something_else_is_refused(
    base: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = ChainDifference.values
    monkeypatch.setattr(ChainDifference, "values", lambda self, s: right(self, s) + 0.002)
    with pytest.raises(ModelError, match=r"differ by 0\.002,"):
        add(
            base.path,
            [NOTHING],
            CHAIN,
            tmp_path / "model.onnx",
            ranges=ranges(*gap_drives()),
            recordings=FIT,
            drives=proof(),
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("which", ["extended", "retrained"])
def test_the_monitor_judges_with_effects_as_streaming_and_in_a_batch(
    which: str, request: pytest.FixtureRequest
) -> None:
    assert_judged_alike(request.getfixturevalue(which))


def test_a_measured_output_forces_the_network_without_the_effect_s_part(
    base: FitResult, extended: Path
) -> None:
    # GIVEN the old model in free run, and the new one with its state forced by old output plus part
    driven = from_recording(gap_drives()[0])
    old, new = Model.load(base.path), Model.load(extended)
    u_old, u_new = inputs_of(old, driven), inputs_of(new, driven)
    newest, part = old.card.state.output_start, network_of(base.path).state_layout.size
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
    for effect in ALL:
        # WHEN an effect is added, of which several read signals that the network does not
        added = ModelEffect.with_values(effect.name, [p.start[0] for p in effect.parameters])
        out = tmp_path / f"{effect.name}.onnx"
        add(path, [added], CHAIN, out, ranges=ranges(driven), recordings=FIT, drives=proof())
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
    card = add(extended, [more], chain, twice, ranges=seen, recordings=FIT, drives=proof())
    add(base.path, [film, more], chain, at_once, ranges=seen, recordings=FIT, drives=proof())
    assert [each["name"] for each in card.effects] == ["wall_film", "back_pressure"]
    recordings = gap_drives()[:1]
    (one,), (other,) = predicted_phi(twice, recordings), predicted_phi(at_once, recordings)
    assert np.array_equal(one, other)
    assert not np.array_equal(one, predicted_phi(extended, recordings)[0])


def test_new_effects_change_nothing_on_healthy_drives_and_older_ones_what_they_did(
    base: FitResult, extended: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN what a training anew is given, of a model without effects and of one with a film
    def given(columns: Sequence[Recording], *_: object, **__: object) -> Prepared:
        taken[:] = [each.column(DIFFERENCE) for each in columns]
        raise RecordingError("enough")

    taken: list[FloatArray] = []
    monkeypatch.setattr("training.gap.add.network.prepare", given)
    chain, film = fitted()
    healthy, driven = healthy_drives()[0], gap_drives()[0]
    seen = ranges(healthy, driven)
    for model in (base.path, extended):
        with pytest.raises(RecordingError, match="enough"):
            retrain(
                model, [film], chain, [driven], tmp_path / "m.onnx", ranges=seen, healthy=[healthy]
            )
        new, known = taken
        older = Model.load(model).card.effects
        difference = ChainDifference.of(
            base.card, [ModelEffect.from_card(each) for each in older], chain, seen
        )
        # THEN on the healthy drive it is the older effects alone, or nothing
        np.testing.assert_array_equal(known, with_difference(healthy, difference).values[:, -1])
        assert bool(older) == bool(np.nanmax(np.abs(known)) > 0.01)
        assert np.nanmax(np.abs(new)) > 0.01


@pytest.mark.parametrize("members", [1, 2])
def test_the_old_network_is_a_start_of_its_retraining(
    members: int, base: FitResult, tmp_path: Path
) -> None:
    # GIVEN a network, or the mean of two, and data of another scaling with an input more
    rng = np.random.default_rng(3)
    one = base.network
    every = [one.weights + 0.02 * i * rng.normal(size=len(one.weights)) for i in range(members)]
    wide, weights = mean_of([(one.spec, each) for each in every])
    path = tmp_path / "model.onnx"
    structure = dict(base.card.structure) | {"members": members}
    card = replace(base.card, layers=wide.hidden, structure=structure)
    save(path, replace(one, spec=wide, weights=weights), card)
    old, chain = network_of(path), fitted()
    difference = ChainDifference.of(card, [chain[1]], chain[0], ranges(*gap_drives()))
    columns = [with_difference(each, difference) for each in gap_drives()]
    data = prepare(columns, (*NARX_INPUTS, DIFFERENCE), OUTPUT, lags=card.lags)
    # WHEN the start runs freely, whatever the new input is
    spec, start = again(card, old, data)
    u = inputs_of(Model.load(path), from_recording(gap_drives()[0]))
    u = np.clip(u, data.scaling.u_low[:-1], data.scaling.u_high[:-1])
    u = np.clip(u, old.scaling.u_low, old.scaling.u_high)
    noisy = np.column_stack([u, 0.1 * rng.normal(size=len(u))])
    new = Network(spec, start, data.scaling, "phi", (), data.names)
    # THEN it is the old network
    assert np.abs(free(new, noisy) - free(old, u)).max() < 1e-6


def test_what_has_no_place_for_effects_is_refused(
    base: FitResult, retrained: Path, tmp_path: Path
) -> None:
    seen, out = ranges(*gap_drives()), tmp_path / "model.onnx"
    with pytest.raises(ModelError, match="was retrained with effects"):
        add(retrained, [NOTHING], CHAIN, out, ranges=seen, recordings=FIT, drives=proof())
    card = replace(base.card, inputs=base.card.inputs[1:])  # without the air
    lacking = {name: each for name, each in seen.items() if name == "fuel_mass_mg"}
    with pytest.raises(ModelError, match="the chain needs engine_speed_rpm"):
        ChainDifference.of(card, [NOTHING], CHAIN, lacking)
    with pytest.raises(UsageError, match="budget ended before the first epoch"):
        retrain(base.path, [fitted()[1]], CHAIN, gap_drives(), out, ranges=seen, budget_minutes=0.0)
    assert not out.exists()
