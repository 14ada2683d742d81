"""Part 1 of the study: outliers, noise lines, and the preparation of the linear baselines."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from monitor.base.errors import RecordingError
from monitor.base.signals import NARX_INPUTS
from monitor.base.types import FloatArray, Quality
from tests.helpers.drives.recordings import recording_of
from tests.helpers.logs.logger_files import drive, write_text_table
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.recordings.recording import Recording, load
from training.recordings.samples.input_choice import choose_inputs
from training.recordings.samples.linear_data import Filter, LinearData, linear_stretches
from training.recordings.samples.preparation import prepare
from training.recordings.spectrum import coherence_limit, find_lines, welch
from training.study.page import section
from training.study.preparation import preparation, unusable

BOSCH = ("speed_z", "load_z", "ignition_angle_z", "fuel_cutoff_z")


def red_noise(seed: int, n: int) -> FloatArray:
    noise = np.random.default_rng(seed).standard_normal(n)
    return np.asarray(signal.lfilter([1.0], [1.0, -0.9], noise))


def lines_of(values: FloatArray, period_s: float) -> list[tuple[float, float]]:
    spectrum = welch([values[:, np.newaxis]], period_s)
    assert spectrum is not None
    found = find_lines(spectrum.frequency_hz, spectrum.density[:, 0], spectrum.averages)
    return [(line.low_hz, line.high_hz) for line in found]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    drive = write(Experiment("wltc_3b", seed=1), tmp_path_factory.mktemp("drive"), "parquet", 0.1)
    result = preparation([load(drive)], NARX_INPUTS, "lambda_measured")
    return json.loads(json.dumps(result, allow_nan=False))  # type: ignore[no-any-return]


def test_the_disturbance_line_of_the_simulated_vehicle_is_found(prepared: dict) -> None:  # type: ignore[type-arg]
    low, high = prepared["band_hz"]
    assert 2.3 < low <= 2.43 and 2.45 <= high < 2.6
    noise = [x for x in prepared["lines"] if x["kind"] == "noise"]
    (line,) = [x for x in noise if x["signal"] == "lambda_measured"]
    assert line["coherence"]["lambda_controller"] > 0.5 > line["coherence"]["lambda_target"]


def test_the_dither_is_commanded_and_not_filtered(prepared: dict) -> None:  # type: ignore[type-arg]
    dither = [x for x in prepared["lines"] if x["kind"] == "commanded"]
    assert dither and all(x["high_hz"] < 2.3 for x in dither)
    assert all(x["coherence"]["lambda_target"] > 0.5 for x in dither)


def test_no_narrow_line_stands_in_the_real_lambda(shared_data: Path) -> None:
    folder = shared_data / "bosch_gengine1"
    runs = [load(folder / f"run_0000{n}.csv.gz") for n in (30, 31)]
    result = preparation(runs, BOSCH, "lambda_z")
    assert result["band_hz"] is None and result["filter"] is None
    assert "The output has no narrow noise band" in section("preparation", {"preparation": result})


def test_red_noise_has_no_lines() -> None:
    found = [lines_of(red_noise(seed, 20_000), 0.1) for seed in range(40)]
    assert sum(map(len, found)) <= 1  # one false line in a thousand spectra is meant


@pytest.mark.parametrize("period_s", [0.01, 0.1, 60.0])
def test_a_weak_sine_is_found_at_any_sample_period(period_s: float) -> None:
    f_hz = 0.12 / period_s
    t_s = np.arange(20_000) * period_s
    values = red_noise(3, 20_000) + 0.25 * np.sin(2 * np.pi * f_hz * t_s)
    ((low, high),) = lines_of(values, period_s)
    assert low < f_hz < high < low + 0.03 / period_s


def test_a_broad_hump_is_no_line() -> None:
    noise = np.random.default_rng(2).standard_normal(20_000)
    hump = signal.sosfilt(signal.butter(2, [0.5, 1.5], "bandpass", fs=10, output="sos"), noise)
    assert lines_of(hump + 0.1 * red_noise(4, 20_000), 0.1) == []


def test_unrelated_signals_stay_below_the_coherence_limit() -> None:
    values = np.column_stack([red_noise(1, 30_000), red_noise(2, 30_000)])
    spectrum = welch([values], 0.1)
    assert spectrum is not None
    beyond = spectrum.coherence[1:-1, 0] > coherence_limit(spectrum.averages)
    assert 0.0 < beyond.mean() < 0.12


def test_every_outlier_is_counted_with_its_reason() -> None:
    # GIVEN an engine speed with three spikes, two impossible values and a gap of ten samples
    speed = 2000.0 + 200.0 * np.sin(np.arange(3000) / 50.0)
    speed += np.random.default_rng(1).standard_normal(3000)
    speed[[500, 900, 1300]] += 2000.0
    speed[[1500, 1501]] = -50.0
    speed[2000:2010] = np.nan
    drive = recording_of({"engine_speed_rpm": speed, "y": red_noise(1, 3000)})
    # THEN each is counted once
    masks = unusable(drive, "engine_speed_rpm")
    counts = {reason: int(mask.sum()) for reason, mask in masks.items()}
    assert counts == {"out_of_range": 2, "spike": 3, "missing": 10}
    result = preparation([drive], ["engine_speed_rpm"], "y")
    assert result["outliers"][0]["longest_gap_s"] == pytest.approx(1.0)


def linear_records(
    recordings: list[Recording], output: str, *inputs: str, reference: LinearData | None = None
) -> tuple[list[tuple[FloatArray, FloatArray]], LinearData]:
    """Return the z-scored inputs and output of every stretch, and the scaling."""
    parts, data = linear_stretches(recordings, inputs, output, reference=reference)
    z = [data.apply(p.values, p.t_s, recordings[p.recording].sha256) for p in parts]
    return [(each[:, :-1], each[:, -1]) for each in z], data


def test_linear_records_are_level_and_of_unit_size() -> None:
    drives = [
        recording_of(
            {
                "u": 5.0 + 0.01 * np.arange(2000) + red_noise(s, 2000),
                "y": -3.0 - 0.02 * np.arange(2000) + red_noise(s + 9, 2000),
            },
            f"d{s}",
        )
        for s in (1, 2)
    ]
    pairs, data = linear_records(drives, "y", "u")
    assert [len(y) for _, y in pairs] == [2000, 2000]
    u, y = (np.concatenate([p[i] for p in pairs]) for i in (0, 1))
    assert u.mean() == pytest.approx(0.0, abs=1e-9) and u.std() == pytest.approx(1.0)
    assert y.std() == pytest.approx(1.0)
    for own_u, own_y in pairs:
        at = np.arange(2000) - 999.5
        assert abs(at @ own_u[:, 0]) < 1e-6 * (at @ at) and abs(at @ own_y) < 1e-6 * (at @ at)
    assert data.names == ("u", "y")


def test_nothing_of_a_held_out_recording_is_looked_at() -> None:
    train = recording_of({"u": red_noise(1, 3000), "y": red_noise(2, 3000)}, "train.csv")
    columns = {"u": 7.0 + 0.01 * np.arange(3000), "y": 2.0 * red_noise(3, 3000)}
    held = recording_of(columns, "held.csv")
    _, data = linear_records([train], "y", "u")
    pairs, same = linear_records([held], "y", "u", reference=data)
    assert same is data
    expected = (held.values - data.mean) / data.std
    assert np.allclose(pairs[0][0][:, 0], expected[:, 0])
    assert np.allclose(pairs[0][1], expected[:, 1])


def test_the_filter_takes_the_line_and_leaves_the_rest() -> None:
    t_s = np.arange(6000) * 0.1
    slow, line = np.sin(2 * np.pi * 0.3 * t_s), np.sin(2 * np.pi * 2.45 * t_s)
    own = Filter.against([2.4, 2.5], 0.1)
    middle = slice(200, -200)
    assert own.kind == "bandstop" and own.attenuation_db > 30.0
    assert np.abs(own.apply(slow)[middle] - slow[middle]).max() < 0.01  # no delay, no loss
    assert np.abs(own.apply(line)[middle]).max() < 10 ** (-own.attenuation_db / 20)
    assert Filter.against([4.4, 4.8], 0.1).kind == "lowpass"


def test_short_holes_are_bridged_and_long_ones_part_stretches() -> None:
    u = red_noise(1, 1000)
    u[[100, 101, 500, 501, 502, 503]] = np.nan
    pairs, _ = linear_records([recording_of({"u": u, "y": red_noise(2, 1000)})], "y", "u")
    assert [len(y) for _, y in pairs] == [500, 496]


def test_constant_and_missing_signals_are_refused_by_name() -> None:
    drive = recording_of({"u": np.full(500, 3.0), "y": red_noise(1, 500)})
    with pytest.raises(RecordingError, match="u is constant"):
        linear_records([drive], "y", "u")
    with pytest.raises(RecordingError, match="has no speed"):
        linear_records([drive], "y", "speed")
    with pytest.raises(RecordingError, match="no stretch of 60 samples"):
        linear_records([recording_of({"u": red_noise(1, 50), "y": red_noise(2, 50)})], "y", "u")


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
