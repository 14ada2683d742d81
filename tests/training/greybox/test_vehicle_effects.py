"""What a healthy vehicle has beside the plain chain: walls that take fuel, a charge that lags.

The plant's walls are of another form than the library's.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.studies.workflow.drive import recording
from benchmarks.studies.workflow.plan import Part
from training.greybox.chain import base_path, simulate
from training.greybox.fit.constants import fit_constants
from training.greybox.fit.drive import ChainDrive, from_recording, joined
from training.greybox.fit.vehicle_effects import own_of
from training.greybox.model import fit_greybox
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording

VEHICLE = 23_001
WALLS = {"wall_film": 8.0}
CYCLES = ("micro_trips", "wltc_3b", "udds", "us06")


@cache
def drives(first_seed: int, *effects: tuple[str, float]) -> tuple[Recording, ...]:
    parts = [Part(cycle, first_seed + i, 60.0, None) for i, cycle in enumerate(CYCLES)]
    return tuple(recording(part, VEHICLE, 500.0, dict(effects), None) for part in parts)


def whole(recordings: tuple[Recording, ...]) -> ChainDrive:
    return joined([from_recording(each) for each in recordings])


def test_a_vehicle_whose_fuel_hardly_meets_walls_has_nothing_beside_the_chain() -> None:
    assert own_of(whole(drives(23_100_000))) == ()


def test_walls_that_take_much_of_the_fuel_are_part_of_a_healthy_vehicles_model(
    tmp_path: Path,
) -> None:
    # GIVEN a vehicle with strong walls, healthy
    old, new = (drives(seed, *WALLS.items()) for seed in (23_200_000, 23_300_000))
    # WHEN a chain is fitted to some drives
    found = fit_greybox(old, tmp_path / "model.onnx")
    # THEN it has walls, and misses much less of other drives
    assert found.greybox.own[0].name == "wall_film"
    alone = fit_constants(whole(old)).constants
    with_walls, without = [], []
    for each, phi in zip(new, predicted_phi(tmp_path / "model.onnx", new), strict=True):
        d = from_recording(each)
        plain = simulate(base_path(alone, d.signals), 0.1)
        with_walls.append((phi - d.phi_measured)[d.scored])
        without.append((plain - d.phi_measured)[d.scored])
    rms = [float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in (with_walls, without)]
    assert rms[0] < 0.6 * rms[1]


def test_coolant_that_never_moves_is_no_input_of_the_walls(tmp_path: Path) -> None:
    # GIVEN healthy drives with strong walls and a warm engine, whose coolant is logged as 90 degC
    warm = []
    for each in drives(23_200_000, *WALLS.items()):
        values = each.values.copy()
        values[:, each.names.index("coolant_temperature_degc")] = 90.0
        warm.append(replace(each, values=values))
    # WHEN a chain is fitted to them, whose inputs nobody has chosen
    found = fit_greybox(warm, tmp_path / "model.onnx")
    # THEN it has walls all the same
    assert found.greybox.own[0].name == "wall_film"
    assert "coolant_temperature_degc" not in found.card.input_names
