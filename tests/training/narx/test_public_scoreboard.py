"""The public scoreboard: files as ``nonlinear_benchmarks`` stores them, one row per test."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.training_sets.public import measure
from benchmarks.training_sets.public_data import Plant, PlantRecord, find
from benchmarks.training_sets.public_models import MODELS


def _resonance(seed: int, n: int) -> PlantRecord:
    """A weakly damped resonance behind a saturation, 1 % of noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, n // 10), 10)
    y = np.zeros(n)
    for t in range(2, n):
        y[t] = 1.6 * y[t - 1] - 0.8 * y[t - 2] + 0.2 * np.tanh(2.0 * u[t - 1])
    return PlantRecord(u[:, None], y + 0.01 * rng.standard_normal(n))


def test_drives_are_split_as_the_public_package_splits_them(tmp_path: Path) -> None:
    # GIVEN a file of coupled electric drives, its name in other letters, in a folder of its own
    (tmp_path / "CED").mkdir()
    rng = np.random.default_rng(0)
    content = {name: rng.random(500) for name in ("u11", "z11", "u12", "z12")}
    savemat(tmp_path / "CED" / "dataunif.mat", content, oned_as="column")
    # WHEN it is read
    plant = find(tmp_path, "ced")
    assert plant is not None
    # THEN the first 400 samples train, the others test, of both records
    assert [len(record.y) for record in plant.train] == [400, 400]
    assert np.array_equal(plant.train[1].u[:, 0], content["u12"][:400])
    assert np.array_equal(plant.tests["high input"].y, content["z12"][400:])
    assert plant.washout == 10


def test_a_plant_with_several_inputs_is_read_from_columns(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    content = {"uEst": rng.random((60, 2)), "yEst": rng.random(60), "Ts": 4.0}
    content |= {"uVal": content["uEst"], "yVal": content["yEst"]}
    savemat(tmp_path / "pilotPlant.mat", content, oned_as="column")
    plant = find(tmp_path, "pilot_plant")
    assert plant is not None
    assert plant.train[0].u.shape == (60, 2)
    assert plant.goals == {"test": 25.0}


def test_a_plant_without_a_file_is_none(tmp_path: Path) -> None:
    assert find(tmp_path, "silverbox") is None


def test_the_scoreboard_compares_free_runs_of_all_models(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # GIVEN a small plant that a network describes better than a linear model
    test = _resonance(2, 500)
    plant = Plant(
        name="resonance",
        period_s=0.1,
        unit="mV",
        per_unit=1e3,
        washout=50,
        train=(_resonance(1, 300),),
        tests={"test": test},
        goals={"test": 40.0},
    )
    # WHEN all models are measured
    rows = measure(plant, list(MODELS), seeds=1, budget_minutes=0.02, epochs=20)
    # THEN the network is better than the ARX
    error = {str(row["model"]): float(row["RMSE"] or 0.0) for row in rows}
    assert error["NARX"] < error["ARX"] < 1e3 * test.y.std()
    assert [row["goal"] for row in rows if row["model"] == "NARX"] == [40.0]
    # AND a package that is not installed is said
    said = capsys.readouterr().err
    for model, package in (("FROLS", "sysidentpy"), ("jax-sysid", "jax_sysid")):
        missing = importlib.util.find_spec(package) is None
        assert (f"{model} is skipped" in said) == missing
        assert (model not in error) == missing
