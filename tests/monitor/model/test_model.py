"""The model file: card, graph, one step, many side by side, export."""

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from benchmarks.damage import fuzz_models
from benchmarks.damage.fuzz_models import hostile, outcome, with_card_text
from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.cli import main
from monitor.model import model_file
from monitor.model.card import Limit, ModelCard, TrainingRecording
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.logs.replays import replay_log
from tests.helpers.models.networks import card_of, network_of
from training.narx.export import Network, build, file_content, update_card, write
from training.narx.network import simulate

INPUTS = ("air_mass_mg", "fuel_mass_mg", "lambda_controller")
STATE = {"output_start": 3, "output_step": 4, "output_count": 5}
LOW, HIGH = np.array([50.0, 0.0, 0.8]), np.array([600.0, 60.0, 1.2])


def network(transform: str = "phi", first_lag: int = 1, hidden: Any = (8, 8)) -> Network:
    return network_of(INPUTS, LOW, HIGH, transform, hidden=hidden, first_lag=first_lag)


def card(net: Network) -> ModelCard:
    recordings = (TrainingRecording("drive.log", "ab" * 32, 1000),)
    limits = {"j_mu": Limit(0.05, "-", "test")}
    return card_of(net, LOW, HIGH, recordings=recordings, limits=limits)


def drive(n: int = 400, seed: int = 1) -> FloatArray:
    """Inputs that also leave the trained range."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(n, 3)), axis=0) / 8
    return np.asarray((LOW + HIGH) / 2 + np.sin(walk) * (HIGH - LOW) * 0.6)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    net = network()
    write(tmp_path / "model.onnx", build(net), card(net))
    return tmp_path / "model.onnx"


def rewrite_card(path: Path, **changes: Any) -> None:
    model = onnx.load(str(path))
    data = json.loads(card(network()).to_json())
    data.update(changes)
    onnx.helper.set_model_props(model, {model_file.CARD: json.dumps(data)})
    path.write_bytes(model.SerializeToString())


def test_the_card_survives_the_file(path: Path) -> None:
    found = Model.load(path).card
    assert found.graph_sha256 == model_file.graph_sha256(path.read_bytes())
    assert dataclasses.replace(found, graph_sha256="") == card(network())


def test_every_batch_size_gives_the_bits_of_single_runs(tmp_path: Path) -> None:
    # GIVEN 70 different drives, and networks of several widths
    for number, net in enumerate(
        [
            network(),
            network(first_lag=0),
            network(hidden=(10,)),
            network("none", hidden=(5, 3)),
        ]
    ):
        file = tmp_path / f"{number}.onnx"
        write(file, build(net), card(net))
        model = Model.load(file)
        u = np.stack([drive(25, seed) for seed in range(70)])
        single = np.empty(u.shape[:2])
        for row in range(70):
            model.reset(u[row, 0], 1.0)
            single[row] = [model.step(sample) for sample in u[row]]
        # WHEN they run side by side in any number THEN not one bit changes
        assert np.ptp(single) > 0.1
        for batch in range(1, 71):
            many = model.with_batch(batch)
            many.reset(u[-batch:, 0], 1.0)
            assert np.array_equal(many.run_batch(u[-batch:]), single[-batch:]), batch


def apart(path: Path, net: Network, u: FloatArray) -> float:
    """Return how far free runs of the file and of the network are apart, in model units."""
    scale, first = net.scaling, net.spec.memory
    scaled = scale.scale_u(u)
    history = np.full((1, net.spec.lags), scale.scale_y(np.array([0.8])))
    start, stop = (np.array([edge]) for edge in (first, len(u)))
    run = simulate(net.spec, net.weights, u=scaled, start=start, stop=stop, history=history)
    model, graph = Model.load(path), np.empty(len(u))
    for k, sample in enumerate(u):
        model.step(sample)
        y = model.state[:, model.card.state.output_start]
        y[:] = 0.8 if k < first else y
        graph[k] = y[0]
    return float(np.abs(graph - scale.unscale_y(run))[first:].max())


@pytest.mark.parametrize("transform", ["phi", "none"])
@pytest.mark.parametrize("first_lag", [0, 1])
@pytest.mark.parametrize("hidden", [(8, 8), (5,), ()])
def test_a_file_runs_freely_as_its_network_does(
    tmp_path: Path, transform: str, first_lag: int, hidden: tuple[int, ...]
) -> None:
    # GIVEN a network and its file, inputs beyond the trained range
    net = network(transform, first_lag, hidden)
    file, u = tmp_path / "m.onnx", drive(300)
    write(file, build(net), card(net))
    # THEN float32 in ONNX and float64 in numpy agree over a free run
    assert apart(file, net, u) < 2e-5
    # and weights that differ by 1 % do not
    other = dataclasses.replace(net, weights=net.weights * 1.01)
    assert apart(file, other, u) > 2e-4


def test_lambda_is_one_over_phi_and_at_most_16(path: Path) -> None:
    model = Model.load(path)
    for u in drive():
        predicted = model.step(u)
        phi = float(model.state[0, model.card.state.output_slice][0])
        assert 0.0 <= phi <= np.float32(1.7)
        assert predicted == pytest.approx(1 / max(phi, 1 / 16), rel=1e-6)
        assert 1 / 1.7 - 1e-6 <= predicted <= 16.0


def test_reset_fills_the_history_with_the_measured_output(path: Path) -> None:
    model = Model.load(path)
    model.step(drive()[3])
    model.reset(drive()[0], 0.8)
    assert np.allclose(model.state[0, model.card.state.output_slice], 1.25)
    first = model.step(drive()[1])
    model.reset(drive()[0], 0.8)
    assert model.step(drive()[1]) == first


def test_a_forced_output_replaces_the_newest_prediction(path: Path) -> None:
    model = Model.load(path)
    model.reset(drive()[0], 1.0)
    model.step(drive()[1])
    model.force_output(0.8)
    history = model.state[0, model.card.state.output_slice]
    assert history[0] == 1.25
    assert history[1] == 1.0
    model.force_output(float("nan"))  # unknown: what stands there stays
    assert history[0] == 1.25


def test_inputs_that_are_not_finite_are_named(path: Path) -> None:
    model, u = Model.load(path), drive()[0].copy()
    u[1] = np.nan
    with pytest.raises(ValueError, match="finite: fuel_mass_mg"):
        model.step(u)
    with pytest.raises(ValueError, match="finite: fuel_mass_mg"):
        model.with_batch(2).step_batch(np.stack([drive()[0], u]))


def test_inputs_far_outside_the_trained_range_change_nothing_more(path: Path) -> None:
    model = Model.load(path)
    model.reset(HIGH * 2, 1.0)
    far = model.step(HIGH * 2)
    model.reset(HIGH * 1000, 1.0)
    assert model.step(HIGH * 1000) == far


def test_a_missing_file_is_an_error_with_its_name() -> None:
    with pytest.raises(ModelError, match=r"nowhere\.onnx: no such model file"):
        Model.load("nowhere.onnx")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": "red"}, "has unknown colour"),
        ({"transform": "log"}, "transform is 'log'"),
        ({"period_ns": "fast"}, "period_ns is 'fast'"),
        ({"schema": "o2_monitor.card/9"}, "wanted 'o2_monitor.card/1'"),
        ({"output": {"name": "y"}}, "output lacks"),
        ({"recordings": 7}, "recordings is 7, wanted a list"),
        ({"checks": {"contraction": {"samples": 1e9}}}, "checks.contraction has 1000000000.0"),
        ({"checks": {"contraction": 5}}, "checks.contraction has 5"),
        (
            {"limits": {"j_mu": {"value": "a", "unit": "-", "origin": ""}}},
            "limits.j_mu.value is 'a'",
        ),
        ({"output_limits": [1, 0]}, "low < high"),
        ({"inputs": []}, "no inputs"),
        ({"state": STATE | {"size": 4}}, "outside"),
        ({"state": STATE | {"size": 24}}, "state has shape ['batch', 20]"),
    ],
)
def test_a_wrong_card_is_refused_by_name(path: Path, changes: dict[str, Any], message: str) -> None:
    rewrite_card(path, **changes)
    with pytest.raises(ModelError) as caught:
        Model.load(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_card_that_lacks_a_key_is_refused() -> None:
    data = json.loads(card(network()).to_json())
    del data["lags"], data["effects"]
    with pytest.raises(ModelError, match=r"x\.onnx: model card lacks effects, lags"):
        ModelCard.from_json(json.dumps(data), "x.onnx")
    with pytest.raises(ModelError, match="not JSON"):
        ModelCard.from_json("{")


def test_update_card_rewrites_the_metadata_alone(path: Path) -> None:
    before = onnx.load(str(path))
    changed = dataclasses.replace(card(network()), limits={"j_mu": Limit(0.07, "-", "again")})
    update_card(path, changed)
    after = onnx.load(str(path))
    assert Model.load(path).card == changed
    assert after.graph == before.graph
    assert [f.name for f in path.parent.iterdir()] == ["model.onnx"]


def test_update_card_refuses_a_card_that_does_not_fit_and_keeps_the_file(path: Path) -> None:
    before = path.read_bytes()
    wrong = dataclasses.replace(card(network()), inputs=card(network()).inputs[:1])
    with pytest.raises(ModelError, match="does not fit"):
        update_card(path, wrong)
    assert path.read_bytes() == before


def test_the_prediction_is_named_after_the_output_and_older_names_are_read(tmp_path: Path) -> None:
    # GIVEN a model of another output, as it is written and as it was
    net = network(transform="none")
    own = card(net)
    level = dataclasses.replace(own, output=dataclasses.replace(own.output, name="level_m"))
    write(tmp_path / "level.onnx", build(net), level)
    (tmp_path / "older.onnx").write_bytes(file_content(build(net), level))
    # THEN the graph says what it predicts
    names = [each.name for each in onnx.load(str(tmp_path / "level.onnx")).graph.output]
    assert names == ["level_m_hat", "next_state"]
    assert onnx.load(str(tmp_path / "older.onnx")).graph.output[0].name == "lambda_hat"
    # and both predict the same
    u = drive(20)
    runs = [Model.load(tmp_path / f"{name}.onnx").run_batch(u[None]) for name in ("level", "older")]
    np.testing.assert_array_equal(*runs)


GOOD = shipped_model().read_bytes()
HOSTILE = dict(hostile(GOOD))


def test_every_bit_of_weights_and_limits_counts(tmp_path: Path) -> None:
    # GIVEN single bits flipped in the weights and in the card, where the file stays a model
    path = tmp_path / "m.onnx"
    tensors = {each.name: each.raw_data for each in onnx.load_from_string(GOOD).graph.initializer}
    places = (
        (GOOD.index(tensors["w0"]), "the graph was changed"),
        (GOOD.index(b'"limits"'), "the model card was changed"),
    )
    for begin, words in places:
        refused = 0
        for at in range(begin, begin + 300, 7):
            changed = bytearray(GOOD)
            changed[at] ^= 1
            path.write_bytes(changed)
            # WHEN it is loaded THEN it is refused, and nearly always for its checksum
            with pytest.raises(ModelError) as error:
                Model.load(path)
            refused += words in str(error.value)
        assert refused > 25


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_asks_for_too_much_is_refused_at_once(tmp_path: Path, name: str) -> None:
    began_s = time.process_time()
    assert outcome(HOSTILE[name], GOOD, tmp_path / "m.onnx") == "refused"
    assert time.process_time() - began_s < 4.0


def test_a_refused_model_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, log = tmp_path / "m.onnx", replay_log("healthy_micro_trips")
    for name in ("deep JSON", "no UTF-8", "outer", "period_ns 1000", "huge integer"):
        path.write_bytes(HOSTILE[name])
        assert main(["replay", str(log), "--model", str(path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"o2mon: {path}: ")


def test_a_model_from_before_the_checksums_gets_them_with_its_next_card(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    text = fuzz_models.card_of(GOOD)
    old = "\n".join(line for line in text.splitlines() if "graph_sha256" not in line)
    path.write_bytes(with_card_text(GOOD, old, signed=False))
    loaded = Model.load(path).card
    assert loaded.graph_sha256 == ""
    # but a file that has one of the two checksums has lost the other
    for text_of, signed in ((old, True), (text, False)):
        path.write_bytes(with_card_text(GOOD, text_of, signed=signed))
        with pytest.raises(ModelError, match="one is missing"):
            Model.load(path)
    path.write_bytes(with_card_text(GOOD, old, signed=False))
    update_card(path, loaded)
    assert Model.load(path).card.graph_sha256 == model_file.graph_sha256(GOOD)
    keys = {each.key for each in onnx.load(str(path)).metadata_props}
    assert keys == {model_file.CARD, model_file.CARD_SHA256}


def test_the_shipped_model_holds_its_checksums() -> None:
    card = Model.load(shipped_model()).card
    assert card.graph_sha256 == model_file.graph_sha256(GOOD)
    assert model_file.CARD_SHA256.encode() in GOOD
