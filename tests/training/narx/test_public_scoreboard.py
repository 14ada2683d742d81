"""The public scoreboard: files as ``nonlinear_benchmarks`` stores them, one row per test."""

from pathlib import Path

import numpy as np
from scipy.io import savemat

from benchmarks.training_sets.public_data import find


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
