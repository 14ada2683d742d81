"""The vehicle's reference from the command line: simulated drives, one fault memory."""

import json
from pathlib import Path

import pytest

from monitor import cli
from monitor.base import faults
from training.dyno.effects import Effects
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment

VEHICLE = 2003
FUELS = (0.0, 0.1, 0.05)  # fraction of ethanol in each tank


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("healthy")
    return [
        write(
            Experiment("micro_trips", VEHICLE, 2_700_000 + i, effects=Effects(ethanol=fuel)),
            folder,
            "csv.gz",
        )
        for i, fuel in enumerate(FUELS)
    ]


def judged(paths: list[Path], out: Path, *more: str) -> tuple[int, list[list[str]]]:
    code = cli.main(["replay", *map(str, paths), "--quiet", "--json", str(out), *more])
    found = json.loads(out.read_text())["recordings"]
    return code, [[dtc["fault"] for dtc in recording["dtcs"]] for recording in found]


def test_an_offset_that_no_fuel_explains_is_found_with_the_vehicles_own_memory(
    healthy: list[Path], tmp_path: Path
) -> None:
    # GIVEN a vehicle that was driven with petrol, E10 and E5
    memory = ("--memory", str(tmp_path / "o2.db"))
    assert judged(healthy, tmp_path / "a.json", *memory) == (0, [[], [], []])
    # WHEN its sensor reads 0.05 too lean
    drive = Experiment(
        "micro_trips",
        VEHICLE,
        2_700_010,
        faults.resolve("biased_lean", 0.05),
        effects=Effects(ethanol=0.05),
    )
    biased = [write(drive, tmp_path, "csv.gz")]
    # THEN that is found, and in a vehicle of which nothing is known it is not
    assert judged(biased, tmp_path / "b.json", *memory) == (1, [["biased_lean"]])
    assert judged(biased, tmp_path / "c.json") == (0, [[]])
    # and it was not learned: the next healthy drive passes, the next biased one is found again
    assert judged(healthy[:1], tmp_path / "d.json", *memory)[1] == [["biased_lean"]]  # pending yet
    recordings = json.loads((tmp_path / "d.json").read_text())["recordings"]
    assert recordings[0]["limits"]["offset_high"] < 0.06
    assert judged(biased, tmp_path / "e.json", *memory)[0] == 1
