"""The grey-box catalyst on a catalyst of other equations, and the command that fits it."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.studies.second import brick as second_catalyst
from monitor.base.errors import RecordingError
from training.cli import main
from training.greybox.catalyst import Catalyst, CatalystDrive, fit, volts
from training.recordings.recording import write_table

PERIOD_S = 0.1
START = (Catalyst(capacity_g=0.1),)


def a_drive(vehicle: int, capacity_g: float, n: int = 3000) -> CatalystDrive:
    own = second_catalyst.brick(vehicle, capacity_g)
    values = second_catalyst.drive(vehicle, vehicle, own)[:n]
    column = dict(zip(second_catalyst.NAMES, values.T, strict=True))
    air_g_s = column["maf_kg_h"] / 3.6
    counts = (column["catalyst_temperature_degc"] > 420.0) & (air_g_s < 30.0)
    x = 1.0 - 1.0 / column["lambda_measured"]
    return CatalystDrive("second", PERIOD_S, x, air_g_s, column["downstream_voltage_v"], counts)


def test_a_fit_orders_catalysts_of_other_equations_with_their_errors() -> None:
    small, large = (fit([a_drive(2, grams)], START) for grams in (0.05, 0.4))
    grams = [fitted.constants["capacity_g"] for fitted in (small, large)]
    assert grams[0]["value"] < 0.1 < grams[1]["value"] < 0.6
    assert all(0.0 < each["standard_error"] < 0.5 * each["value"] for each in grams)
    assert all(abs(each.constants["offset_phi"]["value"]) < 0.006 for each in (small, large))


def test_a_fit_finds_the_constants_that_made_the_voltage_within_its_errors() -> None:
    true = Catalyst(capacity_g=0.2, fill=4.0, release=3.0, offset_phi=0.003, to_lean_s=0.3)
    drive, rng = a_drive(1, 0.2), np.random.default_rng(1)
    made = volts(drive.x, drive.air_g_s, PERIOD_S, true)
    noisy = made + 0.01 * rng.standard_normal(len(made))
    fitted = fit(
        [CatalystDrive("own", PERIOD_S, drive.x, drive.air_g_s, noisy, drive.counts)], START
    )
    for name in ("capacity_g", "offset_phi", "to_lean_s"):
        found = fitted.constants[name]
        error = found["value"] - getattr(true, name)
        assert abs(error) < 4.0 * found["standard_error"] + 1e-4, name
    assert fitted.rmse_v == pytest.approx(0.01, rel=0.1)


def test_standard_errors_do_not_depend_on_which_of_two_periods_comes_first() -> None:
    # GIVEN two drives on grids of different periods
    fine, every = a_drive(2, 0.2, 6000), slice(None, None, 3)
    arrays = (each[every] for each in (fine.x, fine.air_g_s, fine.measured_v, fine.counts))
    coarse = CatalystDrive("coarse", 3.0 * PERIOD_S, *arrays)
    # WHEN they are fitted in either order
    errors = [
        fit(drives, START).constants["capacity_g"]["standard_error"]
        for drives in ([fine, coarse], [coarse, fine])
    ]
    # THEN errors within the same seconds are allowed for
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)


def test_too_few_warm_samples_are_refused() -> None:
    drive = a_drive(1, 0.2, 500)
    with pytest.raises(RecordingError, match="warm"):
        fit([drive], START)


def test_the_command_writes_constants_with_standard_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.greybox.catalyst.fit.__defaults__", (START,))
    values = second_catalyst.drive(2, 2, second_catalyst.brick(2, 0.3))[:3000]
    table, out, t_s = tmp_path / "drive.csv", tmp_path / "catalyst.json", PERIOD_S * np.arange(3000)
    write_table(table, t_s, second_catalyst.NAMES, values)
    call = ["fit", str(table), "--kind", "greybox", "--output", "downstream_voltage_v", "--out"]
    assert main([*call, str(out)]) == 0
    tree = json.loads(out.read_text())
    assert tree["schema"] == "o2train.catalyst/1"
    assert tree["constants"]["capacity_g"]["standard_error"] > 0.0
    assert main([*call, str(tmp_path / "model.onnx")]) == 2
    write_table(table, t_s, second_catalyst.NAMES[1:], values[:, 1:])
    assert main([*call, str(out)]) == 2
