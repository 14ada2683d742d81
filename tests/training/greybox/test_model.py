"""The grey-box chain as a model: its constants, its file, and effects in its graph."""

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.studies.workflow.drive import recording
from benchmarks.studies.workflow.plan import Part
from monitor.base.config import shipped
from monitor.base.errors import ModelError, UsageError
from monitor.controller.export import export
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.models import c_monitor
from training.dyno import vehicle
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.gap.verify.verification import Fold, verify
from training.greybox.chain import RECOVERY_S, base_path, simulate
from training.greybox.charge import INPUTS, ChargeMap
from training.greybox.fit.constants import fit_constants, reference
from training.greybox.fit.drive import ChainDrive, from_recording, joined, phi_of, until
from training.greybox.fit.vehicle_effects import own_of
from training.greybox.graph.chain_graph import Greybox, build
from training.greybox.model import POOR_CORRELATION, GreyboxResult, fit_greybox, greybox_inputs
from training.healthy.base import plain_drives_of
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording, load

PERIOD_S = 0.1
VEHICLE = 2001


def drive(folder: Path, cycle: str, seed: int) -> Recording:
    experiment = Experiment(cycle=cycle, seed=seed, vehicle=VEHICLE, duration_s=900.0)
    return load(write(experiment, folder, "parquet"))


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder = tmp_path_factory.mktemp("drives")
    cycles = (("wltc_3b", 2_000_001), ("micro_trips", 2_000_002), ("us06", 2_000_003))
    return [drive(folder, cycle, seed) for cycle, seed in cycles]


@pytest.fixture(scope="module")
def dense(drives: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> GreyboxResult:
    """The chain with its own charge."""
    return fit_greybox(drives, tmp_path_factory.mktemp("dense") / "model.onnx", inputs=INPUTS)


@pytest.fixture(scope="module")
def result(drives: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> GreyboxResult:
    return fit_greybox(drives, tmp_path_factory.mktemp("greybox") / "model.onnx")


def test_a_simulated_vehicle_s_sensor_and_transport_are_found(result: GreyboxResult) -> None:
    # GIVEN healthy drives of a vehicle whose charge and injector the chain knows badly
    piece = vehicle.piece(VEHICLE)
    late_s = piece.transport_delay_s + 1.5 * 60 / 1500 + piece.mixing_tau_s + piece.sensor_tau_s
    derived = result.card.reference["derived"]["late_at_1500_rpm_s"]
    # THEN the whole lateness and the sensor's span are right all the same
    assert derived["value"] == pytest.approx(late_s, abs=0.02)
    assert result.fitted.constants.span == pytest.approx(piece.sensor_gain, abs=0.03)
    assert result.fitted.constants.dead_time_revolutions == pytest.approx(1.5, abs=0.25)


def test_the_file_says_what_it_is(result: GreyboxResult) -> None:
    assert not any("poorly" in w for w in result.warnings)
    card = Model.load(result.path).card
    assert card == result.card
    assert card.kind == "greybox"
    assert card.input_names == ("fuel_mass_mg", "air_mass_mg", "engine_speed_rpm")
    gain = card.structure["constants"]["gain"]
    assert gain["value"] == result.fitted.constants.gain
    assert gain["low"] < gain["value"] < gain["high"]
    assert gain["standard_error"] > 0.0
    assert card.structure["constants"]["sensor_s"]["unit"] == "s"
    assert "straight line" in card.structure["fixed"]["offset"]
    assert card.reference == reference(result.fitted)
    assert card.fit["test_enabled"]["correlation"] > 0.8
    assert card.checks["contraction"]["gap"] < 1e-4
    assert [r.samples > 5000 for r in card.recordings] == [True] * 3


def test_a_card_rebuilds_its_graph(result: GreyboxResult, dense: GreyboxResult) -> None:
    for found in (result, dense):
        assert build(Greybox.of(Model.load(found.path).card)) == build(found.greybox)
    with pytest.raises(ModelError, match="a narx model, a greybox is wanted"):
        Greybox.of(replace(result.card, kind="narx"))
    for damage in ({"inputs_low": [0.0]}, {"own": ["wall_film"]}, {"charge_map": {"now": 1}}):
        with pytest.raises(ModelError, match="lacks part of its structure"):
            Greybox.of(replace(result.card, structure={**result.card.structure, **damage}))


@pytest.mark.parametrize("chain", ["result", "dense"])
def test_the_graph_computes_what_the_arrays_do_from_the_first_sample_on(
    chain: str, drives: list[Recording], request: pytest.FixtureRequest
) -> None:
    found = request.getfixturevalue(chain)
    follows(found, drives[0])
    assert (drives[0].column("fuel_cut")[:4000] > 0.5).any()


def follows(found: GreyboxResult, recording: Recording) -> None:
    """Assert that the file runs as the arrays do on a recording."""
    u = np.stack([recording.column(name) for name in found.card.input_names], axis=1)[:4000]
    model = Model.load(found.path)
    run = model.run_batch(u[None])[0]
    expected = found.greybox.reading(u.astype(np.float32).astype(np.float64))
    assert np.abs(1.0 / run - np.maximum(expected, 1 / 16)).max() < 1e-5


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc")
@pytest.mark.parametrize("chain", ["result", "dense"])
def test_a_chain_predicts_in_c_as_in_the_runtime(
    chain: str, drives: list[Recording], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    model = Model.load(request.getfixturevalue(chain).path)
    u = np.stack([drives[0].column(name) for name in model.card.input_names], axis=1)[:2000]
    model.card = replace(model.card, limits=Model.load(shipped_model()).card.limits)
    export(model, shipped(), tmp_path)
    wanted = [model.step(each) for each in u]
    assert c_monitor.predicted(tmp_path, tmp_path, u) == pytest.approx(wanted, rel=1e-4)


def test_reset_starts_from_the_inputs_and_the_measured_output(result: GreyboxResult) -> None:
    model = Model.load(result.path)
    u = np.array([20.0, 300.0, 1500.0])
    model.reset(u)
    alone = model.step(u)
    assert alone == pytest.approx(300.0 / 20.0 / 14.7, abs=0.02)
    assert model.step(u) == pytest.approx(alone, abs=1e-5)  # already steady
    model.reset(u, 0.8)
    assert float(model.state[0, 0]) == 1.25
    assert 0.8 < model.step(u) < alone


def test_fuel_cut_reads_lean_though_never_recorded(drives: list[Recording], tmp_path: Path) -> None:
    keep = drives[0].column("fuel_cut") < 0.5
    burning = replace(
        drives[0],
        values=np.where(keep[:, None], drives[0].values, np.nan),
        path=Path("burning.parquet"),
    )
    found = fit_greybox([burning], tmp_path / "m.onnx")
    assert found.card.inputs[0].minimum > 1.0
    model = Model.load(found.path)
    for _ in range(30):
        reading = model.step(np.array([0.0, 100.0, 2000.0]))
    assert reading > 15.9


def without(recording: Recording, *names: str) -> Recording:
    at = [i for i, name in enumerate(recording.names) if name not in names]
    kept = tuple(recording.names[i] for i in at)
    values, quality = recording.values[:, at], recording.quality[:, at]
    return replace(recording, names=kept, values=values, quality=quality)


def test_where_no_charge_is_broadcast_density_serves_and_else_the_air_meter(
    drives: list[Recording], tmp_path: Path
) -> None:
    assert greybox_inputs(drives) == ("fuel_mass_mg", "air_mass_mg", "engine_speed_rpm")
    dense = without(drives[1], "air_mass_mg")
    assert greybox_inputs([drives[0], dense]) == INPUTS
    metered = without(dense, "manifold_pressure_kpa")
    assert greybox_inputs([metered]) == ("fuel_mass_mg", "maf_kg_h", "engine_speed_rpm")
    # An air meter before the manifold tells the charge early, and the chain finds by how much
    found = fit_greybox([metered], tmp_path / "m.onnx")
    assert [(own.name, 0.1 < own.values[0] < 0.4) for own in found.greybox.own] == [
        ("manifold_filling", True)
    ]
    assert found.card.fit["test_enabled"]["correlation"] > POOR_CORRELATION
    follows(found, metered)


def test_engine_speed_is_worked_out_of_air_meter_and_charge_where_nobody_broadcasts_it(
    drives: list[Recording], tmp_path: Path
) -> None:
    # GIVEN a drive with an engine speed, and the same without
    silent = without(drives[0], "engine_speed_rpm")
    assert greybox_inputs([silent]) == ("fuel_mass_mg", "air_mass_mg", "maf_kg_h")
    blank = replace(drives[0], values=drives[0].values.copy())
    blank.values[:, blank.names.index("engine_speed_rpm")] = np.nan  # a log that maps it
    assert greybox_inputs([blank]) == ("fuel_mass_mg", "air_mass_mg", "maf_kg_h")
    # WHEN the chain is fitted to either
    told, made = (
        fit_greybox([each], tmp_path / f"{i}.onnx") for i, each in enumerate((drives[0], silent))
    )
    # THEN it follows the measurement about as well, and the file computes what the fit did
    with_speed, without_speed = (r.card.fit["test_enabled"]["rmse"] for r in (told, made))
    assert without_speed < 1.1 * with_speed
    follows(made, silent)


@pytest.mark.parametrize(
    ("inputs", "output", "message"),
    [
        (("fuel_mass_mg", "air_mass_mg"), "lambda_measured", "needs fuel_mass_mg, engine_speed"),
        (("air_mass_mg", "maf_kg_h"), "lambda_measured", "needs fuel_mass_mg"),
        (("fuel_mass_mg", "engine_speed_rpm"), "lambda_measured", "for its charge air_mass_mg"),
        (("fuel_mass_mg", "engine_speed_rpm", "maf_kg_h"), "o2", "predicts lambda_measured"),
    ],
)
def test_inputs_that_make_no_chain_are_refused(
    drives: list[Recording], tmp_path: Path, inputs: tuple[str, ...], output: str, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        fit_greybox(drives, tmp_path / "m.onnx", inputs=inputs, output=output)


def test_the_error_of_the_broadcast_charge_is_most_of_what_the_chain_misses(
    result: GreyboxResult, dense: GreyboxResult, tmp_path: Path
) -> None:
    # GIVEN an ECU whose air per stroke follows its air meter slowly, and a drive no fit saw
    fresh = drive(tmp_path, "udds", 2_000_004)
    u = np.stack([fresh.column(name) for name in result.card.input_names], axis=1)
    phi = 1.0 / fresh.column("lambda_measured")
    on = ~until(u[:, 0] <= 0.0, RECOVERY_S, PERIOD_S) & (np.arange(len(u)) > 50) & np.isfinite(phi)
    # WHEN the chain runs on the charge as it is broadcast, and less its error
    rmse = []
    for chain in (replace(result.greybox, charge=None), result.greybox):
        run = simulate(
            base_path(chain.constants, chain.seen(dict(zip(chain.inputs, u.T, strict=True)))),
            PERIOD_S,
        )
        rmse.append(float(np.sqrt(np.mean((run - phi)[on] ** 2))))
    # THEN it misses half as much, about as with a charge of its own from manifold pressure
    assert rmse[1] < 0.6 * rmse[0]
    by_air, by_density = (r.card.fit["test_enabled"] for r in (result, dense))
    assert by_density["rmse_model_units"] < by_air["rmse_model_units"]
    assert by_air["rmse_model_units"] < 1.5 * by_density["rmse_model_units"]


def test_a_chain_with_its_own_charge_finds_gain_and_span(dense: GreyboxResult) -> None:
    assert dense.card.fit["test_enabled"]["correlation"] > 0.95
    found, gain = dense.fitted.constants, vehicle.piece(VEHICLE).sensor_gain
    assert (found.gain, found.span) == (pytest.approx(1.0, 1e-3), pytest.approx(gain, abs=0.02))
    assert isinstance(dense.greybox.charge, ChargeMap)


@pytest.mark.parametrize("chain", ["result", "dense"])
def test_where_the_charge_cannot_be_made_nothing_is_scored(
    chain: str, drives: list[Recording], request: pytest.FixtureRequest
) -> None:
    # GIVEN a drive in which what a chain makes its charge of is lost for a minute
    card = request.getfixturevalue(chain).card
    lossy = replace(drives[0], values=drives[0].values.copy())
    for name in ("air_mass_mg", "manifold_pressure_kpa"):
        lossy.values[3000:3600, lossy.names.index(name)] = np.nan
    # WHEN it becomes a drive of the gap workflow
    (made,), (whole,) = (plain_drives_of(card, [each]) for each in (lossy, drives[0]))
    # THEN that minute says nothing, and the others as much as before
    assert whole.scored[3000:3600].mean() > 0.5
    assert not made.scored[3000:3600].any()
    np.testing.assert_array_equal(made.scored[:3000], whole.scored[:3000])


def test_a_chain_with_its_own_charge_is_verified_without_a_broadcast_one(
    dense: GreyboxResult, drives: list[Recording]
) -> None:
    silent = without(drives[2], "air_mass_mg", "maf_kg_h")
    found, told = (
        verify(dense.path, [Fold(None, [each])], chain=dense.fitted.constants, faults=())
        for each in (silent, drives[2])
    )
    assert found.overall.before == told.overall.before > 0.0


WALLED = 23_001
WALLS = {"wall_film": 8.0}
CYCLES = ("micro_trips", "wltc_3b", "udds", "us06")


@cache
def driven(first_seed: int, *effects: tuple[str, float]) -> tuple[Recording, ...]:
    parts = [Part(cycle, first_seed + i, 60.0, None) for i, cycle in enumerate(CYCLES)]
    return tuple(recording(part, WALLED, 500.0, dict(effects), None) for part in parts)


def whole(recordings: tuple[Recording, ...]) -> ChainDrive:
    return joined([from_recording(each) for each in recordings])


def test_a_vehicle_whose_fuel_hardly_meets_walls_has_nothing_beside_the_chain() -> None:
    assert own_of(whole(driven(23_100_000))) == ()


def test_walls_that_take_much_of_the_fuel_are_part_of_a_healthy_vehicles_model(
    tmp_path: Path,
) -> None:
    # GIVEN a vehicle with strong walls, healthy
    old, new = (driven(seed, *WALLS.items()) for seed in (23_200_000, 23_300_000))
    # WHEN a chain is fitted to some drives
    found = fit_greybox(old, tmp_path / "model.onnx")
    # THEN it has walls, and misses much less of other drives
    assert found.greybox.own[0].name == "wall_film"
    alone = fit_constants(whole(old)).constants
    with_walls, without = [], []
    for each, phi in zip(new, predicted_phi(tmp_path / "model.onnx", new), strict=True):
        (d,) = plain_drives_of(found.card, [each])
        # AND its walls are no gap of another drive: they stand in what the gap workflow begins with
        off = np.abs(phi_of(d, found.greybox.constants) - phi)[d.scored]
        assert np.quantile(off, 0.9) < 1e-3
        plain = simulate(base_path(alone, d.signals), 0.1)
        with_walls.append((phi - d.phi_measured)[d.scored])
        without.append((plain - d.phi_measured)[d.scored])
    rms = [float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in (with_walls, without)]
    assert rms[0] < 0.6 * rms[1]


def test_coolant_that_never_moves_is_no_input_of_the_walls(tmp_path: Path) -> None:
    # GIVEN healthy drives with strong walls and a warm engine, whose coolant is logged as 90 degC
    warm = []
    for each in driven(23_200_000, *WALLS.items()):
        values = each.values.copy()
        values[:, each.names.index("coolant_temperature_degc")] = 90.0
        warm.append(replace(each, values=values))
    # WHEN a chain is fitted to them, whose inputs nobody has chosen
    found = fit_greybox(warm, tmp_path / "model.onnx")
    # THEN it has walls all the same
    assert found.greybox.own[0].name == "wall_film"
    assert "coolant_temperature_degc" not in found.card.input_names
