"""Effects in the grey-box graph: they are their numpy forms, and the monitor runs them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import ModelError
from monitor.base.signals import BY_NAME
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import LAMBDA_MAX, Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.gap.gap_graphs import FIT, driven, fitted, plain, ranges_of, recording
from training.gap.add.greybox import add
from training.greybox.chain import Constants
from training.greybox.charge import INPUTS as CHARGE_INPUTS
from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.case import reading
from training.greybox.fit.drive import ChainDrive
from training.greybox.graph.chain_graph import Greybox, build
from training.greybox.model import fit_greybox
from training.narx.export import update_card

TOLERANCE = 1e-5  # phi
MOVED = Constants(
    gain=1.01, dead_time_s=0.17, dead_time_revolutions=1.6, mixing_s=0.05, sensor_s=0.12, span=0.96
)
FILM = ModelEffect.with_values("wall_film", [0.2, 0.8, 1.0], [0.01, 0.1, 0.3])
DELAY = ModelEffect.with_values("delay_flow", [8.0])
TAIL = ModelEffect.with_values("fuel_cut_tail", [0.1, 2.0, 0.5])
PURGE = ModelEffect.with_values("purge", [1.5])


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = fitted(tmp_path_factory.mktemp("base") / "base.onnx")
    limits = Model.load(shipped_model()).card.limits
    update_card(path, replace(Model.load(path).card, limits=limits))
    return path


def run(file: Path, drive: ChainDrive) -> FloatArray:
    """Return the free run (n,) in phi, started as the monitor starts."""
    model = Model.load(file)
    u = np.column_stack([drive.signals[name] for name in model.card.input_names])
    model.reset(u[0])
    return 1.0 / model.run_batch(u[np.newaxis])[0]


def seen(card: ModelCard, drive: ChainDrive) -> ChainDrive:
    """Return the drive with the signals as the graph makes and limits them."""
    greybox = Greybox.of(card)
    u = np.column_stack([drive.signals[name] for name in greybox.inputs])
    return replace(drive, signals=greybox.seen(dict(zip(greybox.inputs, u.T, strict=True))))


def missed(
    file: Path,
    drive: ChainDrive,
    effects: Sequence[ModelEffect],
    constants: Constants | None = None,
) -> float:
    """Return by how much a file misses the arrays with these effects on a drive, in phi."""
    card = Model.load(file).card
    own, values = [each.effect for each in effects], [each.values for each in effects]
    expected = reading(seen(card, drive), constants or Greybox.of(card).constants, own, values)
    readable = np.maximum(expected, 1.0 / LAMBDA_MAX)
    return float(np.abs(run(file, drive) - readable)[card.lags :].max())


@pytest.mark.parametrize("name", ["wall_film", "purge", "maf_pulsation", "back_pressure"])
def test_an_optional_signal_that_the_fit_had_not_is_not_read(
    base: Path, tmp_path: Path, name: str
) -> None:
    # GIVEN drives of a fit without ambient pressure, coolant and purge duty
    effect, out = LIBRARY[name], tmp_path / "m.onnx"
    added = ModelEffect.with_values(name, [p.start[0] for p in effect.parameters])
    card = add(base, [added], out, ranges=ranges_of(*effect.needs), recordings=FIT)
    old = Model.load(base).card.input_names
    assert set(card.input_names) == {*old, *effect.needs}
    # THEN the graph takes the effect's own default
    assert missed(out, plain(), [added]) < TOLERANCE


def test_the_card_says_what_was_added(base: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.onnx"
    old = Model.load(base).card
    vehicle = replace(Greybox.of(old), constants=MOVED)
    card = add(base, [FILM, PURGE], out, ranges=ranges_of(), recordings=FIT, vehicle=vehicle)
    assert Model.load(out).card == card
    further = (
        "coolant_temperature_degc",
        "manifold_pressure_kpa",
        "ambient_pressure_kpa",
        "purge_duty_percent",
    )
    assert card.input_names == (*old.input_names, *further)
    coolant = card.inputs[len(old.inputs)]
    seen = ranges_of()
    assert (coolant.unit, coolant.percentile_0_1) == ("degC", seen[coolant.name][0])
    assert (coolant.minimum, coolant.maximum) == (-40.0, 150.0)  # surroundings: wherever plausible
    pressure = card.inputs[len(old.inputs) + 1]
    signal = BY_NAME[pressure.name]  # only the effect reads it: wherever plausible, too
    assert (pressure.minimum, pressure.maximum) == (signal.minimum, signal.maximum)
    film, purge = card.effects
    assert ModelEffect.from_card(film) == FILM
    assert film["standard_errors"] == {"share": 0.01, "time": 0.1, "cold_growth": 0.3}
    assert film["recordings"][0]["sha256"] == FIT[0].sha256
    assert purge["reads"][-2:] == ["ambient_pressure_kpa", "purge_duty_percent"]
    assert card.recordings == (*old.recordings, *FIT)
    assert (card.limits, card.output_limits) == (old.limits, old.output_limits)
    assert card.structure["constants"]["gain"]["value"] == MOVED.gain
    lag = card.reference["derived"]["lag_s"]
    assert lag["value"] == pytest.approx(MOVED.mixing_s + MOVED.sensor_s)
    assert "before effects were added" in card.reference["standard_errors"]
    assert card.fit == {"before_effects": old.fit}
    assert [p.name for p in tmp_path.iterdir()] == ["m.onnx"]


def test_without_new_constants_the_base_and_its_reference_stay(base: Path, tmp_path: Path) -> None:
    old = Model.load(base).card
    flap = ModelEffect.with_values("empirical:flap:factor:30:10", [1.0, 0.5])  # has no unit here
    seen = {**ranges_of(), "flap": (20.0, 40.0)}
    card = add(base, [FILM, flap], tmp_path / "m.onnx", ranges=seen, recordings=FIT)
    assert (card.inputs[-1].name, card.inputs[-1].unit) == ("flap", "")
    assert card.reference == old.reference
    assert card.structure["constants"] == old.structure["constants"]


def test_a_model_can_be_extended_again(base: Path, tmp_path: Path) -> None:
    # GIVEN two effects added at once, and one after the other
    both, one, two = (tmp_path / f"{name}.onnx" for name in ("both", "one", "two"))
    wide = {"ranges": ranges_of(), "recordings": FIT}
    whole = add(base, [FILM, DELAY, TAIL], both, **wide)
    add(base, [FILM], one, **wide)
    last = add(one, [DELAY, TAIL], two, **wide)
    # THEN the same model comes out, and it reads as the arrays do
    assert last == whole
    assert two.read_bytes() == both.read_bytes()
    assert missed(both, driven(), [FILM, DELAY, TAIL]) < TOLERANCE
    assert build(Greybox.of(last)) == build(Greybox.of(whole))


def test_the_healthy_vehicle_s_volumes_are_part_of_the_base(base: Path, tmp_path: Path) -> None:
    # GIVEN a base with volumes that the healthy vehicle has, and an effect
    own = (
        ModelEffect.with_values("delay_flow", [-0.4]),
        ModelEffect.with_values("mix_flow", [0.6]),
    )
    out, wide = tmp_path / "m.onnx", {"ranges": ranges_of(), "recordings": FIT}
    vehicle = replace(Greybox.of(Model.load(base).card), constants=MOVED, own=own)
    card = add(base, [FILM], out, **wide, vehicle=vehicle)
    # THEN the file reads as the arrays with all of them, and the effect alone is an added one
    assert missed(out, driven(), [*own, FILM], MOVED) < TOLERANCE
    assert missed(out, driven(), [FILM], MOVED) > 0.01
    assert [each["name"] for each in card.effects] == ["wall_film"]
    again = add(out, [DELAY], tmp_path / "again.onnx", **wide)
    assert Greybox.of(again).own == own


def test_the_order_of_effects_is_that_of_their_fit(base: Path, tmp_path: Path) -> None:
    offset = ModelEffect.with_values("injector_offset", [1.0])
    for i, order in enumerate(((FILM, offset), (offset, FILM))):
        out = tmp_path / f"{i}.onnx"
        add(base, order, out, ranges=ranges_of(), recordings=FIT)
        assert missed(out, plain(), order) < TOLERANCE
    assert np.abs(run(tmp_path / "0.onnx", plain()) - run(out, plain())).max() > 1e-3


@pytest.mark.parametrize("batch", [3, 64])
def test_batched_and_single_runs_of_all_effects_give_the_same_bits(
    base: Path, tmp_path: Path, batch: int
) -> None:
    out = tmp_path / "m.onnx"
    starts = {name: [p.start[0] for p in e.parameters] for name, e in LIBRARY.items()}
    every = [ModelEffect.with_values(*each) for each in starts.items()]
    card = add(base, every, out, ranges=ranges_of(), recordings=FIT)
    limits = Greybox.of(card)
    size = (batch, 120, len(card.inputs))
    made = np.random.default_rng(8).uniform(*np.array([*limits.limits.values()]).T, size)
    made[:, 40:60, card.input_names.index("fuel_mass_mg")] = 0.0
    one, many = Model.load(out), Model.load(out, batch)
    many.reset(made[:, 0])
    together = many.run_batch(made)
    for u, row in zip(made[:: batch // 3], together[:: batch // 3], strict=True):
        one.reset(u[0])
        assert np.array_equal([one.step(x) for x in u], row)


def test_a_reset_starts_every_lag_settled(base: Path, tmp_path: Path) -> None:
    # GIVEN a film of ten seconds and an air meter's lags, far slower than the chain's own
    slow = ModelEffect.with_values("wall_film", [0.3, 4.0, 4.0])
    meter = ModelEffect.with_values("maf_offset", [2.0, 2.0])
    out = tmp_path / "m.onnx"
    card = add(base, [slow, meter], out, ranges=ranges_of(), recordings=FIT)
    assert card.lags < 50
    # WHEN the monitor starts anew in the middle of a drive
    u = np.array([plain().signals[name][3000] for name in card.input_names])
    model = Model.load(out)
    model.reset(u)
    first = model.step(u)
    # THEN it stands where it would come to rest
    for _ in range(1000):
        last = model.step(u)
    assert first == pytest.approx(last, abs=2e-6)


@pytest.mark.parametrize(
    "inputs",
    [
        CHARGE_INPUTS,
        ("fuel_mass_mg", "maf_kg_h", "engine_speed_rpm"),
        ("fuel_mass_mg", "air_mass_mg", "maf_kg_h"),
    ],
)
def test_effects_act_on_whatever_charge_the_chain_has(
    tmp_path: Path, inputs: Sequence[str]
) -> None:
    # GIVEN a chain with a charge of its own, or from the air meter, or a speed from both
    bare, out = tmp_path / "bare.onnx", tmp_path / "m.onnx"
    fit_greybox([recording()], bare, inputs=inputs)
    effects = [
        ModelEffect.with_values("manifold_filling", [0.05]),
        ModelEffect.with_values("mix_flow", [1.0]),
        ModelEffect.with_values("maf_offset", [1.0, 0.05]),
    ]
    card = add(bare, effects, out, ranges=ranges_of(), recordings=FIT)
    # THEN flow and filling are that charge's, and at that speed
    assert missed(out, driven(), [*Greybox.of(card).own, *effects]) < TOLERANCE


def test_what_cannot_be_added_is_refused(base: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.onnx"
    nothing = {"recordings": FIT, "ranges": {}}
    with pytest.raises(ModelError, match="rail_exponent needs rail_pressure_mpa: neither an input"):
        add(base, [ModelEffect.with_values("rail_exponent", [0.1])], out, **nothing)
    narx = Path("monitor/model/shipped.onnx").resolve()
    with pytest.raises(ModelError, match="a narx model, a greybox is wanted to add effects"):
        add(narx, [FILM], out, **nothing)
    with pytest.raises(ModelError, match="'cylinder_imbalance' is not in the library: wall_film"):
        ModelEffect.with_values("cylinder_imbalance", [1.0])
    with pytest.raises(ModelError, match="wall_film has parameters share, wanted share, time"):
        replace(FILM, parameters={"share": 0.1})
    assert not out.exists()


def test_a_card_whose_effects_are_not_ours_is_refused(base: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.onnx"
    card = add(base, [FILM], out, ranges=ranges_of(), recordings=FIT)
    entry = dict(card.effects[0])
    for effects, message in (
        ({**entry, "name": "turbo_lag"}, "'turbo_lag' is not in the library"),
        ({n: v for n, v in entry.items() if n != "parameters"}, "lacks 'parameters'"),
        ({n: v for n, v in entry.items() if n != "reads"}, "lacks 'reads'"),
    ):
        update_card(out, replace(card, effects=(effects,)))
        with pytest.raises(ModelError, match=message):
            Greybox.of(Model.load(out).card)
