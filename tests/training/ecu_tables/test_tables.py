"""Tables for an ECU: axes of a tune, files, sensitivities, and the command end to end."""

import io
import json
import re
import tracemalloc
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from benchmarks.verdicts.true_tables import true_tables
from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from training.cli import main
from training.cli.progress import Share
from training.cli.tables import grid
from training.dyno.engine import EngineLayout, dead_time_ms, engine
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.ecu_tables.balance import balance, balance_text
from training.ecu_tables.config import defaults
from training.ecu_tables.files import csv, tuner_studio
from training.ecu_tables.fit import _Problem, fit
from training.ecu_tables.msq import injectors_text, read_axes
from training.ecu_tables.page import heading, heat, plan
from training.ecu_tables.parameters import SHARE_MOST, Parameters, Vector, grid_over
from training.ecu_tables.prediction import PredictionCase, air_mg, reading
from training.ecu_tables.signals import subject_of
from training.ecu_tables.tables import LINKS, _Cells, _Law, _table, tables
from training.pages.heat import LEVELS, HeatCell
from training.recordings.ecu_table import KPA, EcuTable, axes_of
from training.recordings.recording import Recording, load

TUNE = """<?xml version="1.0" encoding="ISO-8859-1"?>
<msq xmlns="http://www.msefi.com/:msq"><page number="0">
<constant cols="1" name="frpm_table1" rows="3" units="RPM">
 800.0
 1600.0
 2400.0
</constant>
<constant cols="1" name="fmap_table1" rows="2" units="kPa">30 60</constant></page></msq>
"""


def test_the_axes_of_a_tune_are_those_of_its_fuel_table(tmp_path: Path) -> None:
    tune = tmp_path / "CurrentTune.msq"
    tune.write_text(TUNE)
    assert read_axes(tune, KPA) == ((800.0, 1600.0, 2400.0), (30.0, 60.0))


def delays(axes: Any, values: FloatArray, **more: Any) -> EcuTable:
    """Return a table of delays of which all is known but ``more``."""
    own = {"low": values, "high": values, "samples": np.full(values.shape, 100)} | more
    own["seconds"], sides = 0.05 * own["samples"], (axes.speed, axes.load)
    return EcuTable(name="lambda_delay", unit="s", axes=sides, estimate=values, **own)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (TUNE.replace("<msq", '<!DOCTYPE msq [<!ENTITY a "b">]><msq'), "document type"),
        (TUNE.replace("1600.0", "500.0"), "rising"),
        (TUNE.replace("30 60", "low high"), "numbers are wanted"),
        (TUNE.replace("kPa", "mg/stroke"), "fmap_table1 is in mg/stroke, for these logs kPa"),
        (TUNE.replace("kPa", "% TPS"), "fmap_table1 is in % TPS, for these logs kPa is wanted"),
        (TUNE.replace("fmap_table1", "other"), "no axes of speed and load"),
        ("rpm,map\n1,2\n", "no tune in XML"),
    ],
)
def test_a_file_without_axes_is_refused_by_name(tmp_path: Path, text: str, reason: str) -> None:
    tune = tmp_path / "bad.msq"
    tune.write_text(text)
    with pytest.raises(UsageError, match=reason) as refused:
        read_axes(tune, KPA)
    assert "bad.msq" in str(refused.value)


def test_a_table_file_has_speed_across_load_upwards_and_zero_where_nothing_was_measured() -> None:
    axes = axes_of("manifold_pressure_kpa", (800.0, 1600.0, 2400.0), (30.0, 60.0))
    values = np.array([[0.3, 0.25], [0.2, np.nan], [0.15, 0.1]])
    table = delays(axes, values, samples=np.ones((3, 2), dtype=np.int64))
    root = ET.fromstring(tuner_studio(table))
    space = "{http://www.EFIAnalytics.com/:table}"
    rows = root.find(f"{space}table/{space}zValues")
    assert rows is not None and rows.text is not None
    assert [line.split() for line in rows.text.strip().splitlines()] == [
        ["300", "200", "150"],
        ["250", "0", "100"],
    ]
    assert csv(table).splitlines()[4] == "1600,60,,,,1,,"
    assert table.document()["estimate"][1] == [0.2, None]


def log_of(folder: Path, injection: str, air: str, seconds: float, **car: Any) -> Path:
    """Write a log of a simulated car."""
    layout = EngineLayout(injection, air)  # type: ignore[arg-type]
    experiment = Experiment(cycle="micro_trips", duration_s=seconds, layout=layout, **car)
    return write(experiment, folder, "csv", 0.05)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    return log_of(folder, "port", "speed_density", 150.0, vehicle=3, seed=4)


def changed(log: Recording, name: str, values: Any, rows: Any = slice(None)) -> Recording:
    """Return a log with other values of a signal in some rows."""
    whole = log.values.copy()
    whole[rows, log.names.index(name)] = values
    return replace(log, values=whole)


def test_the_sensitivities_are_the_derivatives_of_the_reading(drive: Path) -> None:
    subject = subject_of([load(drive)])
    d = subject.drives[0]
    p = Parameters(subject, grid_over(d.rpm, d.load))
    x = p.mean() + 0.05 * np.random.default_rng(1).standard_normal(p.size)
    x[p.at["flow"]] = 1.5
    case = PredictionCase.of(d, p)
    moving = reading(Vector(p, x, moving=True), case)
    slopes = p.jacobian(moving)
    np.testing.assert_allclose(moving.value, reading(Vector(p, x), case))
    for k in (*range(19), *(p.at[name].start + 7 for name in ("delay", "lag", "share", "tau"))):
        step = 1e-6 * np.eye(p.size)[k]
        up, down = (reading(Vector(p, x + by), case) for by in (step, -step))
        wanted = (up - down) / 2e-6
        error = np.sqrt(np.mean((slopes[:, k] - wanted) ** 2))
        assert error <= 0.01 * np.sqrt(np.mean(wanted**2)) + 1e-9, k


def test_the_charge_behind_an_air_meter_is_free_of_its_lag_and_of_the_manifolds_filling(
    tmp_path: Path,
) -> None:
    # GIVEN a charge that swings once a second, seen by a meter with a lag of 30 ms, in a log that
    # goes on after the engine
    log = load(log_of(tmp_path, "port", "maf", 25.0))
    subject = subject_of([changed(log, "engine_speed_rpm", 0.0, slice(-20, None))])
    d = subject.drives[0]
    assert d.rejected["the engine stands"] == 20
    p = Parameters(subject, grid_over(d.rpm, d.load))
    filling_s, meter_s, omega = 0.19, 0.03, 2.0 * np.pi
    t_s = np.arange(len(d)) * d.period_s
    swing = np.exp(1j * omega * t_s)
    seen = swing * (1.0 + 1j * omega * filling_s) / (1.0 + 1j * omega * meter_s)
    drive = replace(d, rpm=np.full(len(d), 2000.0), air=200.0 + 50.0 * seen.real)
    # WHEN the charge is taken from the meter's flow
    x = p.mean()
    x[p.at["filling"]], x[p.at["meter"]] = np.log(2000.0 * filling_s), np.log(meter_s)
    charge = air_mg(Vector(p, x), drive)
    # THEN it is the charge in the cylinder
    assert np.abs(charge - (200.0 + 50.0 * swing.real))[t_s > 2.0].max() < 1.0


def test_a_log_becomes_tables_with_bounds_and_blank_cells(
    tmp_path: Path, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tune, out = tmp_path / "t.msq", tmp_path / "out"
    tune.write_text(TUNE.replace(" 800.0", " 0.0"))  # an engine at rest is in no cell
    # a short log knows no delay within what an ECU needs, and the command says so
    call = ["tables", str(drive), "--out", str(out), "--axes", str(tune)]
    assert main(call) == 0 and "more with wide intervals: --rough" in capsys.readouterr().out
    # a table that a user changed, or made, is no file of the earlier run; all others give way
    mine = out / "lambda_lag.csv"
    mine.write_text(mine.read_text() + "mine")
    assert main([*call, "--rough"]) == 2
    assert f"{mine}: is there already; --force replaces it" in capsys.readouterr().err
    (out / "injector_flow_scale.csv").write_text("mine")
    assert main([*call, "--rough", "--force"]) == 0
    assert (out / "injector_flow_scale.csv").read_text() == "mine"
    assert not mine.read_text().endswith("mine")
    said = capsys.readouterr().out
    assert "more with" not in said
    assert re.search(r"lambda_lag: \d+ of \d+ cells, \d+ to \d+ ms", said)
    (out / "injector_flow_scale.csv").unlink()
    earlier = json.loads((out / "tables.json").read_text())
    earlier["files"]["wall_film_old_degc.csv"] = sha256(b"earlier").hexdigest()
    (out / "tables.json").write_text(json.dumps(earlier))
    (out / "wall_film_old_degc.csv").write_text("earlier")
    assert main([*call, "--rough"]) == 0
    assert not (out / "wall_film_old_degc.csv").exists()
    document = json.loads((out / "tables.json").read_text())
    assert document["schema"] == "o2train.tables/1"
    names = [t["name"] for t in document["tables"]]
    assert {"lambda_delay", "lambda_lag", "wall_film_time", "injector_dead_time"} <= set(names)
    # no displacement: the air has no scale
    assert not {"injector_flow_scale", "sensor_lag"} & {*names}
    delay = document["tables"][names.index("lambda_delay")]
    estimate, low, high = (np.array(delay[k], float) for k in ("estimate", "low", "high"))
    samples = np.array(delay["samples"])
    filled = np.isfinite(estimate)
    assert filled.any()
    assert np.isnan(estimate[samples < 100]).all()
    assert (low[filled] < estimate[filled]).all() and (estimate[filled] < high[filled]).all()
    assert "drive that fills" in (out / "report.html").read_text()
    cycles = document["tables"][names.index("lambda_delay_cycles")]
    per_s = np.array(delay["axes"][0]["values"])[:, None] / 120.0
    np.testing.assert_allclose(np.array(cycles["estimate"], float), estimate * per_s, rtol=1e-5)
    assert document["notes"]["the logs' steady balance"].startswith("dead time ")
    # a cell tells where in the log the car stayed in it longest
    at_s = np.array(delay["at_s"], dtype=float)
    assert (np.isfinite(at_s) == (samples > 0)).all()
    assert ((np.array(delay["log"]) == drive.name) == (samples > 0)).all()
    rpm = load(drive).column("engine_speed_rpm")[np.round(at_s[samples > 0] / 0.05).astype(int)]
    speeds = np.array(delay["axes"][0]["values"])
    nearest = np.abs(rpm[:, None] - speeds).argmin(axis=1)
    assert (nearest == np.nonzero(samples)[0]).all()


def test_a_log_without_fuel_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "nofuel.csv"
    rows = "\n".join(f"{0.05 * k:.2f},1500,{1 + 0.01 * (k % 7)},40" for k in range(200))
    path.write_text(f"time_s,engine_speed_rpm,lambda_measured,manifold_pressure_kpa\n{rows}\n")
    assert main(["tables", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "injector_pulse_width_ms or fuel_mass_mg" in capsys.readouterr().err
    # AND a file of somebody else in the folder is left as it is
    (tmp_path / "lambda_delay.csv").write_text("mine")
    assert main(["tables", str(path), "--out", str(tmp_path)]) == 2
    assert "lambda_delay.csv: is there already" in capsys.readouterr().err


def test_a_log_with_hardly_a_usable_sample_is_refused_with_the_reasons(drive: Path) -> None:
    log = load(drive)
    n = len(log.values)
    standing = changed(changed(log, "lambda_measured", 1.7), "engine_speed_rpm", 0.0, slice(120))
    single = changed(log, "lambda_measured", np.nan, slice(-1))
    for bad, seconds, why in (
        (standing, r"0\.0", f"{n - 120} where lambda stands still for 2 s, 120 where the engine s"),
        (single, r"0\.1", f"{n - 1} where a signal has no value"),
    ):
        told = f"{seconds} s of usable samples, at least 5 s are wanted: {why}"
        with pytest.raises(RecordingError, match=told):
            subject_of([bad])


def test_a_log_on_a_slow_grid_knows_no_delay_and_says_so(drive: Path) -> None:
    log = load(drive)
    slow = replace(log, values=log.values[::40], quality=log.quality[::40], period_ns=40 * 10**9)
    subject, shares = subject_of([slow]), list[float]()
    fitted = fit(subject, lambda share, _: shares.append(share))
    assert shares == sorted(shares) and shares[-1] == 1.0  # whose progress never goes back
    delay = tables(fitted, axes_of(subject.load), defaults())[0]
    assert np.isnan(delay.estimate).all() and "the interval is too wide" in delay.reasons()


def test_logs_whose_readings_are_updated_at_different_rates_count_all(drive: Path) -> None:
    # GIVEN two logs with a row each 50 ms, whose sensors send each 150 ms and each 200 ms
    log = load(drive)
    rows = [np.arange(len(log.values)) // every * every for every in (3, 4)]
    subject = subject_of([replace(log, values=log.values[at]) for at in rows])
    # WHEN their noise is estimated THEN samples of both count
    assert [d.every for d in subject.drives] == [3, 4]
    problem = _Problem.of(subject, subject.drives, 2)
    noise = problem.noise(problem.p.mean())
    assert all(noise.kept(d.usable).sum() > 50 for d in subject.drives)


def test_a_signal_that_a_log_names_without_a_value_is_none(drive: Path) -> None:
    log = load(drive)
    values = changed(log, "coolant_temperature_degc", np.nan).values
    values = np.column_stack([values, np.full(len(values), np.nan)])
    empty = replace(log, names=(*log.names, "rail_pressure_mpa"), values=values)
    full = replace(empty, values=np.nan_to_num(values, nan=20.0))
    for logs in ([empty], [full, log]):  # AND a rail pressure of one log alone scales no fuel
        assert all((each.pressure == 1.0).all() for each in subject_of(logs).drives)
    assert subject_of([empty]).samples == subject_of([log]).samples


def test_a_file_gets_lines_with_share_time_left_and_the_best_error_so_far() -> None:
    out, now_s = io.StringIO(), [0.0]
    with Share("tables", out, lambda: now_s[0]) as bar:
        bar.update(0.1, 0.0125)  # too soon for a line
        now_s[0] = 40.0
        bar.update(0.25, 0.02)
    assert out.getvalue() == "tables: 25 % done, 120 s left, best error 0.0125 phi\n"


def test_the_charge_of_one_cylinder_follows_from_their_number(tmp_path: Path) -> None:
    recording = load(log_of(tmp_path, "port", "speed_density", 30.0))
    both = [subject_of([recording], None, *of) for of in ((2.0, 4), (3.0, 6))]
    np.testing.assert_allclose(*(each.drives[0].air for each in both))
    cases = [_Problem.of(each, each.drives, 2).cases[0] for each in both]
    np.testing.assert_allclose(cases[1].point.flow_kg_h, 1.5 * cases[0].point.flow_kg_h)
    for size, told in (  # AND no engine is without either, nor is air per stroke known without
        ({"displacement_l": 0.0}, " 0: .* are wanted"),
        ({"cylinders": 0}, " 0: .* are wanted"),
        ({"load": "air_mass_mg"}, "a load axis in mg needs the displacement"),
    ):
        with pytest.raises(UsageError, match=told):
            subject_of([recording], **size)  # type: ignore[arg-type]


def test_where_the_rail_pressure_is_lost_no_pulse_tells_a_flow(tmp_path: Path) -> None:
    # GIVEN a log of direct injection whose rail pressure is lost for half a minute
    whole = load(log_of(tmp_path, "direct", "speed_density", 90.0))
    lossy = changed(whole, "rail_pressure_mpa", np.nan, slice(600, 1200))
    # THEN that half minute counts nowhere but in its first second, for which the value is held
    usable = subject_of([lossy]).drives[0].usable
    assert not usable[620:1200].any()
    np.testing.assert_array_equal(usable[:600], subject_of([whole]).drives[0].usable[:600])


def test_direct_injection_has_its_short_dead_time(tmp_path: Path) -> None:
    # GIVEN a car whose drive is explained nearly as well by a wet wall and a long dead time
    log = log_of(tmp_path, "direct", "speed_density", 200.0, vehicle=216, seed=21600)
    subject = subject_of([load(log)], displacement_l=2.0)
    # WHEN its tables are made
    made = {t.key: t for t in tables(fit(subject), axes_of(subject.load), defaults())}
    # THEN the dead time is the true one
    dead = made["injector_dead_time"]
    true = dead_time_ms(engine(216, EngineLayout("direct", "speed_density")), np.array([14.0]))
    assert abs(dead.estimate[dead.axes[0].values.index(14.0)] - true[0]) < 0.05


def test_a_reading_that_is_updated_seldomer_than_logged_tells_the_true_lag(tmp_path: Path) -> None:
    # GIVEN a log with rows each 50 ms, whose sensor sends a new value each 200 ms
    layout = EngineLayout("direct", "maf")
    experiment = Experiment(cycle="wltc_3b", vehicle=211, seed=12, duration_s=400.0, layout=layout)
    log = load(write(experiment, tmp_path, "csv", 0.05))
    measured = log.column("lambda_measured")
    held = changed(log, "lambda_measured", measured[np.arange(len(measured)) // 4 * 4])
    # WHEN its tables are estimated
    subject = subject_of([held])
    axes, fitted = axes_of(subject.load), fit(subject)
    lag = next(t for t in tables(fitted, axes, defaults()) if t.name == "lambda_lag")
    # THEN nearly all intervals, nine of ten by their claim, hold the true lag
    true = true_tables(experiment.engine, axes, 25.0)["lambda_lag"]
    filled = np.isfinite(lag.estimate)
    assert filled.sum() >= 5
    held_true = (lag.low <= true) & (true <= lag.high)
    assert held_true[filled].mean() >= 0.8
    # AND a value counts for the time until the next, in cells and in the steady balance
    assert lag.seconds.sum() > 0.9 * 0.05 * subject_of([log]).samples
    assert fitted.parameters.fuel.seconds > 60.0


def cells(value: float, log_sd: float, seconds: float = 20.0) -> _Cells:
    """Return a table's only cell as one log, or all of them, tell it."""
    number, stay = np.array([400], np.int64), (np.array(["a.csv"]), np.zeros(1))
    return _Cells(np.log([value]), np.array([log_sd**2]), number, np.array([seconds]), *stay)


def cell(name: str, whole: _Cells, *logs: _Cells) -> EcuTable:
    """Return a table of one cell."""
    if name in LINKS:  # on the scale of odds
        share = np.exp(whole.free)
        whole = whole._replace(free=np.log(share / (SHARE_MOST - share)))
    axis = axes_of("manifold_pressure_kpa", (800.0,), (30.0,))
    law = _Law(name, "-", (axis.speed, axis.load), np.exp, ())
    return _table(law, whole, logs, defaults(), np.zeros(1, dtype=bool))


@pytest.mark.parametrize(
    ("name", "value", "log_sd", "told"),
    [
        ("lambda_delay", 0.1, 0.06, True),
        ("lambda_delay", 0.3, 0.06, False),  # known within a tenth, not within what an ECU needs
        ("wall_film_fraction", 0.012, 0.7, False),  # 1.2 % and perhaps 4 % is no answer
        ("wall_film_fraction", 0.8, 2.0, False),  # near the law's limit, it may as well be 0.3
    ],
)
def test_a_cell_that_is_not_known_within_what_an_ecu_needs_is_blank(
    name: str, value: float, log_sd: float, told: bool
) -> None:
    table = cell(name, cells(value, log_sd))
    assert np.isfinite(table.estimate).all() == told
    assert table.reasons() == ("" if told else "the interval is too wide: 1")


def test_logs_that_agree_leave_the_interval_and_logs_that_disagree_widen_it() -> None:
    # GIVEN a flow that all logs together know within 3 %
    whole = cells(3.0, 0.03)
    # WHEN each log alone tells the same, or 8 % less and more
    alike = cell("injector_flow_scale", whole, cells(2.97, 0.05), cells(3.03, 0.05))
    apart = cell("injector_flow_scale", whole, cells(2.77, 0.03), cells(3.25, 0.03))
    # THEN only the second interval is wider, and holds both logs
    assert alike.widened == 1.0
    assert apart.widened > 1.5
    assert apart.low[0, 0] < 2.77 and apart.high[0, 0] > 3.25
    # AND the console shows the flow over the fuel pressure
    flow = replace(alike, unit="mg/ms", axes=(axes_of("air_mass_mg").pressure(direct=False),))
    text = grid(heading(flow), heat(flow))
    assert text.startswith("Injector flow, mg/ms over fuel pressure [-]\n") and " 3.00 ±" in text


def test_a_cell_whose_logs_exclude_each_other_is_blank_and_says_so() -> None:
    table = cell("injector_flow_scale", cells(2.1, 0.03), cells(3.0, 0.03), cells(1.5, 0.03))
    assert np.isnan(table.estimate).all()
    assert table.reasons() == "the logs disagree: 1"


def test_a_log_that_hardly_saw_a_cell_has_no_say_in_it() -> None:
    short = cells(0.3, 0.03, seconds=2.0)
    assert cell("lambda_delay", cells(0.1, 0.06), cells(0.1, 0.06), short).widened == 1.0


def test_the_steady_balance_tells_flow_and_dead_time_where_moves_are_weak(tmp_path: Path) -> None:
    # GIVEN steps of the pulse width of which a lagging air estimate lets only half arrive
    pulse_ms = np.repeat([2.0, 3.0, 5.0, 8.0, 4.0, 2.5, 6.0, 3.5], 200)
    wobble = 0.05 * np.sin(np.arange(len(pulse_ms)))
    air_mg = 3.0 * (pulse_ms - 0.9) * 14.5
    t_s, volts = 0.05 * np.arange(len(pulse_ms)), np.full(len(pulse_ms), 14.0)
    moves = [1.0 - 0.5 * wobble, pulse_ms * (1.0 + wobble)]
    rows = np.column_stack([t_s, 1500 + 100 * pulse_ms, *moves, air_mg, 10 * pulse_ms, volts])
    path = tmp_path / "steps.csv"
    names = "time_s,engine_speed_rpm,lambda_measured,injector_pulse_width_ms,air_mass_mg"
    head = f"{names},manifold_pressure_kpa,battery_voltage_v"
    np.savetxt(path, rows, "%.6g", ",", header=head, comments="")
    subject = subject_of([load(path)])
    # WHEN the level of the mixture is taken over seconds
    d = subject.drives[0]
    p = Parameters(subject, grid_over(d.rpm, d.load))
    found = balance(p)
    # THEN it tells the injectors within its interval, and a text says so
    half = 1.645 * np.sqrt(np.diag(found.covariance))
    true = np.log([3.0 * 14.5 / 14.7, 0.9])
    assert (np.abs(found.mean[:2] - true) < np.minimum(half[:2], 0.1)).all()
    assert balance_text(replace(p, fuel=found)).startswith("flow 2.9")
    # AND two hours of logs take no more memory than a small computer has
    hours = replace(subject, drives=subject.drives * 90)
    tracemalloc.start()
    balance(Parameters(hours, grid_over(d.rpm, d.load)))
    assert tracemalloc.get_traced_memory()[1] < 5e8
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("constants", "told"),
    [
        (
            {"reqFuel": 12.5, "injOpen": 1.3, "battFac": 0.2},
            "flow 2.58 mg/ms (reqFuel 12.5 ms), dead time 1.14 ms (injOpen 1.3 ms)",
        ),
        ({"injector_flow": 240.0}, "flow 2.98 mg/ms"),
        ({}, ""),
    ],
)
def test_a_tune_tells_its_injectors(tmp_path: Path, constants: dict[str, float], told: str) -> None:
    tune = tmp_path / "t.msq"
    lines = "".join(f'<constant name="{name}">{v}</constant>' for name, v in constants.items())
    tune.write_text(TUNE.replace("</page>", f"{lines}</page>"))
    assert injectors_text(tune, 1.6, 4) == told


def test_the_drive_plan_asks_for_no_load_beyond_the_visited_ones() -> None:
    # GIVEN delays of a speed driven at 30 and 80 kPa, and one driven at 80 kPa alone, all blank
    axes = axes_of("manifold_pressure_kpa", (2000.0, 7000.0), (20.0, 30.0, 50.0, 80.0, 100.0))
    samples = np.array([[0, 9, 0, 9, 0], [0, 0, 0, 9, 0]])
    blank = np.full(samples.shape, np.nan)
    # WHEN a drive is planned, THEN it fills what lies between, and asks for nothing else
    assert {leg.place for leg in plan([delays(axes, blank, samples=samples)])} == {
        "2000 rpm at 30, 50, 80 kPa",
        "7000 rpm at 80 kPa",
    }


def test_the_page_colours_cells_and_tells_where_they_were_driven() -> None:
    axes = axes_of("manifold_pressure_kpa", (800.0, 1600.0), (30.0, 60.0))
    values = np.array([[0.3, 0.25], [0.2, np.nan]])
    driven = {"log": np.full((2, 2), "monday.msl"), "at_s": np.array([[1.0, 2.0], [3.0, 4.0]])}
    table = delays(axes, values, low=values - 0.01, high=values + 0.01, **driven)
    shown = heat(table)
    assert [label for label, _ in shown.rows] == ["60", "30"]  # the highest load on top
    top, bottom = (cells for _, cells in shown.rows)
    assert bottom[0] == HeatCell("300", "±10", LEVELS, "monday.msl from 1 s")
    assert bottom[1].level == 0 and top[0].level == LEVELS // 2
    assert top[1] == HeatCell("5 s", "", None, "monday.msl from 4 s")  # blank: too little, calm
