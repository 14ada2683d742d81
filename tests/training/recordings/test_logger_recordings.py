"""Logger's files as training recordings: inputs chosen, pinned values left out, one grid."""

from pathlib import Path

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.signals import NARX_INPUTS
from monitor.base.types import Quality
from tests.helpers.drives.recordings import recording_of
from tests.helpers.logs.logger_files import drive, write_text_table
from training.recordings.recording import Recording, load
from training.recordings.samples.input_choice import choose_inputs
from training.recordings.samples.preparation import prepare

COBB = ("Time (sec)", "RPM (RPM)", "AF Sens 1 Ratio (AFR)", "Boost (PSI)", "MAF (g/s)")


def recording(names: tuple[str, ...], n: int = 50) -> Recording:
    values = 1.0 + np.random.default_rng(3).random((n, len(names)))
    return recording_of(dict(zip(names, values.T, strict=True)))


def cobb(path: Path, step_s: float) -> Path:
    """Write a log of a tuner's logger."""
    d = drive(900, step_s)
    load = d["map_kpa"] / 100.0
    columns = [d["t_s"], d["rpm"], d["afr"], -11.0 + 9.0 * load, 60.0 * load]
    return write_text_table(path, dict(zip(COBB, columns, strict=True)))


def test_the_inputs_are_those_of_the_paper_where_they_are_there() -> None:
    every = recording((*NARX_INPUTS, "engine_speed_rpm", "lambda_measured"))
    assert choose_inputs([every], "lambda_measured") == NARX_INPUTS


@pytest.mark.parametrize(("hottest_degc", "chosen"), [(31.0, False), (55.0, True)])
def test_intake_air_is_an_input_if_the_logs_know_more_than_the_weather_of_their_days(
    hottest_degc: float, chosen: bool
) -> None:
    # GIVEN two logs, the air of one between 24 and 28 degC, of the other up to the hottest
    names = ("injector_pulse_width_ms", "manifold_temperature_degc", "engine_speed_rpm")
    logs = [recording((*names, "lambda_measured")) for _ in range(2)]
    for log, high in zip(logs, (28.0, hottest_degc), strict=True):
        log.values[:, 1] = np.linspace(24.0, high, len(log.values))
    # THEN it is an input only where their range is wide
    assert (names[1] in choose_inputs(logs, "lambda_measured")) == chosen


def test_of_each_cause_the_best_signal_that_moves_is_an_input() -> None:
    names = ("injector_pulse_width_ms", "load_g_per_rev", "engine_speed_rpm", "lambda_controller")
    log = recording((*names, "lambda_measured", "throttle_percent"))
    assert choose_inputs([log], "lambda_measured") == names
    # a controller that never moves is none, and without fuel the throttle helps
    log.values[:, names.index("lambda_controller")] = 1.0
    assert "lambda_controller" not in choose_inputs([log], "lambda_measured")
    bare = recording(("manifold_pressure_kpa", "engine_speed_rpm", "throttle_percent"))
    assert choose_inputs([bare], "lambda_measured") == bare.names
    # only what all recordings have counts
    message = "all recordings have engine_speed_rpm, lambda_measured; --columns"
    with pytest.raises(RecordingError, match=message):
        choose_inputs([log, recording(("engine_speed_rpm", "lambda_measured"))], "lambda_measured")


def test_a_pinned_sensor_is_no_measurement_outside_fuel_cut() -> None:
    names = ("engine_speed_rpm", "manifold_pressure_kpa", "fuel_cut", "lambda_measured")
    log = recording(names, 2000)
    log.values[:, 1] += 50.0
    log.values[:, 2] = 0.0
    log.values[500:600, 2] = 1.0
    log.quality[500:700, 3] = Quality.PINNED
    data = prepare([log], names[:2], "lambda_measured")
    unscored = np.flatnonzero(data.samples.weight == 0.0)
    assert unscored.tolist() == list(range(600, 700))


def test_logs_of_one_logger_at_different_rates_come_to_one_grid(tmp_path: Path) -> None:
    from training.cli import options

    fast = cobb(tmp_path / "a.csv", step_s=0.1)
    slow = cobb(tmp_path / "b.csv", step_s=0.5)
    read = options.load_all(options.ReadOptions(), [fast, slow], None)
    assert [each.period_ns for each in read] == [500_000_000] * 2
    assert load(fast).period_ns == 100_000_000
