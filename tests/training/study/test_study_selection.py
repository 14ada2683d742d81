"""Part 2 of the study: principal components, input sets in free run, transparency."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.faults import resolve
from tests.helpers.drives.recordings import recording_of
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.recordings.recording import Recording, load
from training.recordings.samples.preparation import enabled_rows
from training.recordings.sensor_fault import faulty_readings
from training.study.page import section
from training.study.selection.input_sets import InputSet, aligned, try_sets
from training.study.selection.selection import CANDIDATES, candidates, pca, selection
from training.study.selection.transparency import estimate_controller
from training.study.task import Settings, Task

STEP_S = 0.01  # of the plant below; recordings have 0.1 s
DRIVE = Experiment(cycle="micro_trips", seed=4, duration_s=700.0)
LAMBDA_INPUTS = ("air_mass_mg", "fuel_mass_mg", "lambda_controller")


def closed_loop_drive(seed: int, n: int = 2500) -> Recording:
    """An engine with a wandering injector under a PI controller with dither, at 100 Hz."""
    rng = np.random.default_rng(seed)
    many = 10 * n
    air = np.repeat(200.0 + 80.0 * np.tanh(np.cumsum(0.2 * rng.standard_normal(n // 5))), 50)
    gain = 1.0 + 0.04 * np.sin(np.arange(many) * STEP_S / 9.0 + rng.uniform(0, 6))
    gain *= 1.0 + 0.03 * np.sign(air - 200.0)
    target = 1.0 + 0.03 * np.sign(np.sin(2 * np.pi * 0.4 * np.arange(many) * STEP_S))
    phi, trim, fuel = np.ones(many), np.ones(many), np.empty(many)
    gas = seen = expected = 1.0
    integral = 0.0
    for k in range(many):
        fuel[k] = air[k] / 14.7 * target[k] * trim[k - 1]
        late = max(k - 20, 0)
        gas += (14.7 * fuel[late] / air[late] * gain[late] - gas) * STEP_S / 0.1
        expected += (target[late] - expected) * STEP_S / 0.1
        seen += (gas - seen) * STEP_S / 0.05
        error = expected - seen
        integral += 0.4 * error * STEP_S
        trim[k] = 1.0 + integral + 0.1 * error
        phi[k] = seen
    rows = slice(9, None, 10)
    noise = 0.001 * rng.standard_normal(n)
    return recording_of(
        {
            "air_mass_mg": air[rows],
            "fuel_mass_mg": fuel[rows],
            "lambda_controller": trim[rows],
            "lambda_target": 1.0 / target[rows],
            "lambda_measured": 1.0 / (phi[rows] + noise),
        },
        f"drive{seed}.csv",
    )


def nonlinear_drive(seed: int, n: int = 2500) -> Recording:
    """Output of two inputs through a static curve and a lag; a third input does nothing."""
    rng = np.random.default_rng(seed)
    u = np.stack(
        [np.convolve(rng.standard_normal(n + 9), np.ones(10) / 3, "valid")[:n] for _ in range(3)]
    )
    y = np.zeros(n)
    for t in range(2, n):
        y[t] = 0.7 * y[t - 1] + np.tanh(u[0, t - 1]) + 0.2 * u[1, t - 2] ** 2
    names = ("speed", "load", "idle")
    columns = dict(zip(names, u, strict=True)) | {"y": y + 0.05 * rng.standard_normal(n)}
    return recording_of(columns, f"run{seed}.csv")


def select(
    drive: Recording, inputs: tuple[str, ...], output: str, seed: int = 0, minutes: float = 2.0
) -> dict[str, Any]:
    settings = Settings(budget_minutes=minutes, seed=seed)
    return selection(Task((drive,), (), (), (), inputs, output, Path(), settings, jobs=1), {})


@pytest.fixture(scope="module")
def healthy_drive(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return load(write(DRIVE, tmp_path_factory.mktemp("drive"), "parquet", 0.1))


@pytest.fixture(scope="module")
def chosen() -> dict[str, Any]:
    """Selection on a drive in closed loop, after a round through JSON."""
    result = select(closed_loop_drive(1, 1200), LAMBDA_INPUTS, "lambda_measured", 1, 0.05)
    return json.loads(json.dumps(result, allow_nan=False))  # type: ignore[no-any-return]


def test_components_are_those_of_the_correlation_matrix() -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal((500, 4)) @ rng.standard_normal((4, 4)) * [1, 10, 100, 5] + 7
    found = pca(values, "abcd")
    expected = np.corrcoef(values.T)
    loadings, variances = np.array(found["loadings"]), np.array(found["variances"])
    assert np.allclose(variances, np.linalg.eigvalsh(expected)[::-1], rtol=1e-4)
    assert np.allclose(loadings * variances @ loadings.T, expected, atol=1e-4)
    assert found["kept"] == int((np.array(found["explained"]) < 0.9).sum()) + 1


def test_the_candidates_are_the_eleven_where_they_are_recorded() -> None:
    columns = {name: np.zeros(3) for name in (*CANDIDATES, "lambda_measured", "battery_voltage_v")}
    assert len(CANDIDATES) == 11
    assert candidates([recording_of(columns)], CANDIDATES[:7]) == CANDIDATES
    other = recording_of({name: np.zeros(3) for name in ("speed", "load", "y")})
    assert candidates([other], ("load",)) == ("load",)


def test_every_set_of_inputs_gets_the_same_samples_and_blocks() -> None:
    # GIVEN a drive whose load is missing for a while, and one spike of the idle input
    drive = nonlinear_drive(3, 1200)
    drive.values[400:460, 1] = np.nan
    drive.values[800, 2] += 100.0
    same = aligned([drive], ("speed", "load", "idle"))
    sets = [InputSet("a", ("speed", "idle")), InputSet("b", ("load",))]
    tried = try_sets(same, sets, "y", seed=0, budget_minutes=0.02, jobs=1)
    one, two = (t.data for t in tried)
    assert one.segments == two.segments and len(one.segments) == 3
    assert np.array_equal(one.role, two.role)
    assert np.array_equal(one.samples.y, two.samples.y)
    assert np.isfinite(drive.values[0]).all()  # the recording itself is as it was


def test_leaving_out_what_matters_is_worse_and_what_does_not_is_not() -> None:
    left_out = select(nonlinear_drive(1), ("speed", "load", "idle"), "y")
    full, *others = left_out["sets"]
    rmse = {s["name"]: s["rmse"] / full["rmse"] for s in others}
    assert rmse["without speed"] > 1.1 and rmse["without load"] > 1.1
    assert rmse["without idle"] < 1.1
    assert full["correlation"] > 0.98 and full["inputs"] == ["speed", "load", "idle"]
    assert left_out["transparency"] is None
    assert "is known to come from a controller of the measured y" in section(
        "selection", {"selection": left_out}
    )


def test_the_law_of_the_controller_is_found_with_sign_and_dead_time() -> None:
    law = estimate_controller([closed_loop_drive(5), closed_loop_drive(6)], "lambda_measured")
    assert law is not None and law.stable
    assert law.explained > 0.9
    assert law.measured.sum() < 0.0  # a rich reading takes fuel away
    assert 2 <= law.dead_time <= 5  # 0.2 s of transport, and lags of 0.1 and 0.05 s
    # a lasting offset of the reading ends as its opposite in the controller
    steady = law.response(np.full(2000, 0.02), np.ones(2000, dtype=bool))
    assert steady[-1] == pytest.approx(-0.02, rel=0.1)


@pytest.mark.parametrize("fault", ["slow_symmetric", "delay_symmetric", "gain_low"])
def test_the_law_moves_as_the_simulated_vehicle_does_with_the_fault_in_its_loop(
    fault: str, healthy_drive: Recording, tmp_path: Path
) -> None:
    # GIVEN the same simulated drive, healthy and with the fault in the loop
    experiment = replace(DRIVE, fault=resolve(fault))
    faulty = load(write(experiment, tmp_path, "parquet", 0.1))
    law = estimate_controller([healthy_drive], "lambda_measured")
    assert law is not None
    # WHEN the fault is put on the healthy reading and the law answers
    phi = 1.0 / healthy_drive.column("lambda_measured")
    read = 1.0 / faulty_readings(resolve(fault), 1.0 / phi, 0.1)
    closed = np.isfinite(read) & enabled_rows(healthy_drive) & enabled_rows(faulty)
    answer = law.response(np.where(closed, read - phi, 0.0), closed)
    # THEN it moves as the simulated ECU's controller did, in shape and size
    real = faulty.column("lambda_controller") - healthy_drive.column("lambda_controller")
    assert np.corrcoef(answer[closed], real[closed])[0, 1] > 0.7
    assert 0.5 < answer[closed].std() / real[closed].std() < 2.0


def test_without_closed_loop_no_law_is_found() -> None:
    drive = closed_loop_drive(7, 500)
    open_loop = recording_of(
        {n: drive.column(n) for n in drive.names} | {"closed_loop": np.zeros(500)}
    )
    assert estimate_controller([open_loop], "lambda_measured") is None


def test_a_fault_reaches_the_prediction_only_through_the_controller(chosen: dict[str, Any]) -> None:
    reach = chosen["transparency"]["reach"]
    share = {(r["set"], r["fault"]): r["share"] for r in reach}
    for fault in ("slow_symmetric", "delay_symmetric", "gain_low"):
        assert share["without the controller", fault] == 0.0
        assert share["chosen", fault] > 0.0
    # The others drive a network beyond what it was trained on: what it does there is chance.
    assert share["chosen", "slow_symmetric"] < share["controller exact", "slow_symmetric"]
    assert max(v for (name, _), v in share.items() if name == "controller exact") > 0.1


def test_a_constant_candidate_is_refused_by_name() -> None:
    columns = {n: nonlinear_drive(1, 300).column(n) for n in ("speed", "load", "y")}
    drive = recording_of(columns | {"load": np.full(300, 2.0)})
    with pytest.raises(RecordingError, match="load is constant"):
        select(drive, ("speed", "load"), "y", minutes=0.02)
