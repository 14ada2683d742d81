"""``o2train gap`` on what it cannot use: one line and exit 2, or a report of what is left."""

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copy
from typing import Any

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.recordings import recording_of
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from tests.helpers.gap.gap_simulated import run
from training import cli
from training.gap.inputs import suitability
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.effects.model_effect import ModelEffect, uncertain
from training.greybox.fit.drive import ChainDrive, make
from training.healthy import behaviour, coverage
from training.healthy.operating_points import Visited
from training.narx.export import update_card
from training.recordings.files.table_files import write_table
from training.recordings.recording import Recording

DRY = ("fuel_mass_mg", "air_mass_mg")
INPUTS = ("fuel_cut", "engine_speed_rpm", "manifold_pressure_kpa")


def table(
    folder: Path,
    seed: int,
    n: int = 6000,
    without: Sequence[str] = (),
    rich: float = 0.0,
    period_s: float = PERIOD_S,
    **changed: FloatArray,
) -> Path:
    """Write a drive made of formulas; ``rich`` is phi more at high load than at low."""
    signals = plain_signals(n, seed) | changed
    phi = simulate(base_path(Constants(), signals), PERIOD_S)
    phi += 0.002 * np.random.default_rng([seed, 8]).standard_normal(n)
    phi += rich * (signals["manifold_pressure_kpa"] - 70.0) / 100.0
    columns = {name: x for name, x in signals.items() if name not in without}
    columns["fuel_cut"] = (signals["fuel_mass_mg"] == 0.0).astype(float)
    columns["lambda_measured"] = 1.0 / np.maximum(phi, 0.07)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"drive_{seed}.csv"
    write_table(path, np.arange(n) * period_s, tuple(columns), np.column_stack([*columns.values()]))
    return path


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three drives that have all signals."""
    folder = tmp_path_factory.mktemp("drives")
    return [table(folder, seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def chain(drives: list[Path]) -> Path:
    """A chain of one of them: from three on a healthy reference is learned, which takes long."""
    path = drives[0].parent / "chain.onnx"
    assert cli.main(["fit", str(drives[0]), "--kind", "greybox", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small network of two drives without fuel and air per stroke."""
    folder = tmp_path_factory.mktemp("network")
    path, drives = folder / "network.onnx", [table(folder, i, without=DRY) for i in (21, 22)]
    options = ["--inputs", *INPUTS, "--lags", "3", "--hidden", "4", "--starts", "1"]
    arguments = ["fit", *map(str, drives), *options, "--budget", "0.02", "--out", str(path)]
    assert cli.main(arguments) == 0
    return path


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Give what returns the error line of a command that must fail with exit code 2."""

    def line(model: Path, *arguments: str | Path) -> str:
        capsys.readouterr()
        code = run("--model", model, *arguments, "--out", tmp_path / "gap")
        err = capsys.readouterr().err
        assert code == 2, err
        (only,) = err.strip().splitlines()
        return only

    return line


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--add", "wall_fim"], "effect 'wall_fim' is unknown; there are wall_film"),
        (["--steps", "0"], "--steps is 1 to 3"),
        (["--steps", "4"], "--steps is 1 to 3"),
    ],
)
def test_options_that_cannot_be_are_refused(
    options: list[str], words: str, drives: list[Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert words in refused(shipped_model(), drives[0], *options)
    assert not (tmp_path / "gap").exists()


def test_a_model_of_another_kind_or_none_is_refused(
    drives: list[Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    other = tmp_path / "other.onnx"
    copy(shipped_model(), other)
    card = Model.load(other).card
    update_card(other, replace(card, transform="none"))
    assert "other.onnx: predicts lambda_measured as it is" in refused(other, drives[0])
    assert "drive_1.csv" in refused(drives[0], drives[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"n": 500}, "60 wanted"),
        ({"n": 1500}, "5 min are wanted"),
        ({"without": ["fuel_mass_mg"]}, "no good value of fuel_mass_mg.*a network on other inputs"),
    ],
)
def test_a_recording_of_which_the_chain_can_make_nothing_is_refused(
    changes: dict[str, Any], words: str, chain: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    line = refused(chain, table(tmp_path, 4, **changes))
    assert re.search(rf"drive_4\.csv: .*{words}", line)


def test_recordings_without_excitation_are_refused(
    chain: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    n = 6000
    flat = {
        "air_mass_mg": np.full(n, 200.0),
        "fuel_mass_mg": np.full(n, 200.0 / 14.7),
        "engine_speed_rpm": np.full(n, 2000.0),
        "maf_kg_h": np.full(n, 48.0),
    }
    still = [table(tmp_path, seed, **flat) for seed in (6, 7)]
    line = refused(chain, *still)
    assert "drive_6.csv, drive_7.csv: no excitation" in line
    assert re.search(r"\b(199|200|201) mg of air per stroke", line)  # with the model's own charge
    assert "must move by 10 %" in line


def test_recordings_that_do_not_go_with_each_other_or_the_model_are_refused(
    chain: Path, drives: list[Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    assert "drive_1.csv: the same as " in refused(chain, drives[0], "--healthy", *drives)
    slow = refused(chain, drives[0], "--period", "0.2")
    assert "drive_1.csv: sample period 0.2 s, the model has 0.1 s" in slow
    without = table(tmp_path, 9, without=["fuel_mass_mg"])
    dry = refused(chain, drives[0], "--healthy", without)
    assert "drive_9.csv: healthy, without a good value of fuel_mass_mg" in dry


def compared(network: Path, folder: Path, rich: float) -> tuple[dict[str, Any], str]:
    """Return the answer on recordings without fuel and air per stroke."""
    new, known = (
        [table(folder / name, seed, without=DRY, rich=more) for seed in seeds]
        for name, seeds, more in (("new", (21, 22, 23), rich), ("healthy", (31, 32, 33), 0.0))
    )
    out, roles = folder / "gap", (*new[:2], "--healthy", *known, "--verify", new[2])
    assert run("--model", network, *roles, "--out", out) == 0
    found: dict[str, Any] = json.loads((out / "gap.json").read_text())
    return found, (out / "report.html").read_text()


def test_without_fuel_and_air_the_report_says_in_what_runs_differ(
    network: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "gap").mkdir()
    copy(network, tmp_path / "gap" / "offer.onnx")  # of an earlier run
    found, page = compared(network, tmp_path, rich=0.05)
    assert not (tmp_path / "gap" / "offer.onnx").exists()
    assert found["verdict"] == "unknown_effect"
    regimes = [each for each in found["where"] if each["kind"] == "regime"]
    first = next(each for each in regimes if each["driver"] != "everywhere")
    assert first["driver"] in ("manifold_pressure_kpa", "maf_kg_h", "rail_pressure_mpa")
    assert first["regime"] in found["unknown_effect"]
    assert found["effects"] == found["ranking"] == []
    assert [each["path"] for each in found["held_out"]] == ["drive_23.csv"]
    assert found["base"] is found["rmse_after"] is None
    assert found["rmse_before"] > 0.01
    assert found["skipped"]["wall_film"] == ["fuel_mass_mg"]  # air comes of meter and speed
    assert any("no effect could be tried" in text for text in found["warnings"])
    assert "no effect could be tried" in capsys.readouterr().err
    assert "no candidate" not in page
    assert "Record fuel and air per stroke" in page


def test_without_fuel_and_air_a_vehicle_as_it_was_has_no_gap(network: Path, tmp_path: Path) -> None:
    found, page = compared(network, tmp_path, rich=0.0)
    assert found["verdict"] == "no_gap"
    assert "not beyond what healthy recordings differ by" in page
    assert found["where"] == []
    assert "drive_21.csv, drive_22.csv: the model was fitted to them" in found["warnings"][1]
    assert found["measured_on"] == "the recordings"


def test_without_fuel_and_air_healthy_recordings_are_wanted(
    network: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    dry, one = (table(tmp_path, i, without=DRY) for i in (9, 10))
    for healthy in ([], ["--healthy", one]):
        assert re.search("drive_9.csv cannot .*, 3 or more", refused(network, dry, *healthy))


USUAL = Constants()


def drive(seed: int, constants: Constants = USUAL, **changed: FloatArray) -> ChainDrive:
    """Return ten minutes of a chain with those constants and a little noise."""
    signals = plain_signals(6000, seed) | changed
    noise = 0.002 * np.random.default_rng([seed, 8]).standard_normal(6000)
    phi = simulate(base_path(constants, signals), PERIOD_S) + noise
    return make(f"drive_{seed}", PERIOD_S, signals, 1.0 / np.maximum(phi, 0.07))


def recording(seed: int, without: Sequence[str] = (), period_s: float = 0.1) -> Recording:
    columns = {n: x for n, x in plain_signals(900, seed).items() if n not in without}
    columns["lambda_measured"] = np.ones(900)
    return recording_of(columns, f"drive_{seed}.csv", period_s, f"{seed:064x}")


CARD = Model.load(shipped_model()).card


def test_air_per_stroke_may_come_from_air_meter_and_speed_and_speed_from_both_others() -> None:
    assert suitability.lacking([recording(1, without=["air_mass_mg"])]) == {}
    assert suitability.lacking([recording(1, without=["engine_speed_rpm"])]) == {}
    neither = recording(1, without=["engine_speed_rpm", "maf_kg_h"])
    assert suitability.lacking([neither]) == {"engine_speed_rpm": ["drive_1.csv"]}
    # AND what only the model reads is wanted before anything is fitted
    roles = {"RECORDING": [recording(1, ["rail_pressure_mpa"])], "--healthy": [], "--verify": []}
    with pytest.raises(RecordingError, match=r"drive_1\.csv: has no rail_pressure_mpa"):
        suitability.check_files(roles, CARD)


def test_an_effect_whose_signal_healthy_recordings_lack_is_warned_of() -> None:
    def warned(*lacking: str) -> list[str]:
        return suitability.unlearned_effect_warnings([recording(1)], [recording(2, lacking)])

    (text,) = warned("rail_pressure_mpa")
    assert text.startswith("rail_exponent: healthy recordings lack rail_pressure_mpa")
    assert warned() == []
    assert warned("engine_speed_rpm") == []  # the air meter tells it


def test_a_model_that_hardly_follows_its_own_vehicle_is_warned_of() -> None:
    assert suitability.poor_model_warnings(CARD) == []
    weak = replace(CARD, fit={"test": {}, "test_enabled": {"correlation": 0.2}})
    assert "0.20" in suitability.poor_model_warnings(weak)[0]
    never_enabled = replace(
        weak, fit={"test": {"correlation": 0.2}, "test_enabled": {"samples": 0}}
    )
    assert "0.20" in suitability.poor_model_warnings(never_enabled)[0]


def test_a_constant_smaller_than_its_standard_error_is_warned_of() -> None:
    sure = ModelEffect.with_values("injector_offset", [0.2])
    name = next(iter(sure.parameters))
    doubtful = replace(sure, standard_errors={name: 0.3})
    assert uncertain([replace(sure, standard_errors={name: 0.1})]) == []
    assert f"{name} is 0.2 mg/stroke with a standard error of 0.3" in uncertain([doubtful])[0]
    unseen = replace(sure, standard_errors={name: 0.0})
    assert "do not determine" in uncertain([unseen])[0]
    # and a share of about none is known as well as any other
    leak = ModelEffect.with_values("exhaust_leak", [0.05, 30.0, 0.0], [0.002, 2.0, 0.1])
    assert uncertain([leak]) == []
    unknown = replace(leak, standard_errors=dict(leak.standard_errors) | {"place": 0.45})
    (warning,) = uncertain([unknown])
    assert "place is 0, which the recordings of the fit do not determine" in warning


def test_cells_count_as_visited_from_fifteen_seconds_on() -> None:
    n = 6000
    speed = np.where(np.arange(n) < 1000, 3000.0, 2000.0)
    speed[-100:] = 5000.0  # for ten seconds
    warm = drive(1, engine_speed_rpm=speed, air_mass_mg=np.full(n, 250.0))
    visited = Visited.of([warm])
    on = visited.on(warm)
    assert on[warm.scored & (speed == 3000.0)].mean() > 0.9
    assert not on[speed == 5000.0].any()
    cold = replace(warm, signals={**warm.signals, "coolant_temperature_degc": np.full(n, 10.0)})
    assert not visited.on(cold).any()


def test_drives_that_do_not_say_their_coolant_temperature_count_as_of_any() -> None:
    warm = drive(1, engine_speed_rpm=np.full(6000, 2000.0), air_mass_mg=np.full(6000, 250.0))
    signals = dict(warm.signals)
    assert signals.pop("coolant_temperature_degc") is not None
    silent = replace(warm, signals=signals)
    assert Visited.of([warm]).on(silent)[warm.scored].all()
    assert Visited.of([silent]).on(warm)[warm.scored].all()


def test_drives_where_no_healthy_one_has_been_are_warned_of() -> None:
    # GIVEN healthy drives with a warm engine, and new ones of which one is cold
    known = behaviour.learn([drive(seed) for seed in (1, 2, 3)], USUAL)
    cold = drive(5, coolant_temperature_degc=np.full(6000, 10.0))
    # WHEN they are to be named
    assert coverage.coverage_warnings([drive(4)], known) == []
    left_out, share = coverage.coverage_warnings([drive(4), cold], known)
    # THEN the cold one is said to be left out
    assert left_out.startswith("drive_5: left out of the naming")
    assert left_out.endswith("at coolant temperatures that no healthy recording has visited")
    assert share.startswith("5")
    assert "name nothing" in share


def test_a_recording_without_three_good_samples_in_a_row_is_refused_by_its_name() -> None:
    whole = [drive(seed) for seed in (1, 2)]
    nothing = replace(drive(3), scored=np.arange(6000) % 3 > 0)
    suitability.check_long(whole, "new")
    with pytest.raises(RecordingError, match="drive_3: less than 60 s can be scored"):
        suitability.check_long([*whole, nothing], "new")
