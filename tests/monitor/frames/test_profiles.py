"""Profiles: recognition, units, pinned values, derived signals, times, a logger of one's own."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dbc
from monitor.base.errors import ConfigError, RecordingError
from monitor.base.types import Quality
from monitor.cli import main
from monitor.frames.profiles.profile import load_profile, profile_of, shipped, shipped_profile
from monitor.frames.profiles.recognition import recognised
from monitor.frames.profiles.times import held
from monitor.frames.tables.readers import open_table
from monitor.grid.table_samples import table_block
from monitor.grid.tables import Table, read_table, table_period_ns
from monitor.mapping.profile_proposal import proposed
from monitor.report.check_table import check_table
from tests.helpers.logs.logger_files import Field, drive, write_mlg, write_text_table
from training.healthy.new_model import tree_of

D = drive()
LAMBDA = D["afr"] / 14.7
RUSEFI = [
    Field("Time", "s"),
    Field("RPM", "RPM", ">u2"),
    Field("MAP", "kPa", ">u2", 1 / 30),
    Field("Lambda", "", ">u2", 0.0001),
    Field("Fuel: Last inj pulse width", "ms", ">u2", 1 / 300),
    Field("VBatt", "V", ">u2", 0.001),
    Field("CLT", "deg C", ">i2", 0.01),
    Field("Fuel: Trim bank 1", "%", ">i2", 0.01),
    Field("dfcoActive", "", "u1"),
]


def msl(path: Path, afr: np.ndarray = D["afr"], **more: np.ndarray) -> Path:
    columns = {
        "Time": D["t_s"],
        "SecL": np.floor(D["t_s"]),
        "RPM": D["rpm"],
        "MAP": D["map_kpa"],
        "AFR": afr,
        "MAT": 1.8 * D["iat_c"] + 32.0,
        "CLT": 1.8 * D["clt_c"] + 32.0,
        "Batt V": D["battery_v"],
        "EGO cor1": D["ego_percent"],
        "VE1": D["ve_percent"],
        "PW": D["pw_ms"],
        **more,
    }
    units = ["s", "s", "RPM", "kPa", "AFR", "°F", "°F", "v", "%", "%", "ms", *[""] * len(more)]
    return write_text_table(
        path,
        columns,
        separator="\t",
        encoding="cp1252",
        units=units,
        preamble=('"MS2Extra comms330NP: MS2/Extra release 3.3.1"', '"Capture Date: Mon"'),
    )


def column(table: Table, name: str) -> np.ndarray:
    return table.values[:, table.names.index(name)]


@pytest.mark.parametrize("is_proposed", [False, True])
def test_a_tunerstudio_log_becomes_canonical_signals(tmp_path: Path, is_proposed: bool) -> None:
    path = msl(tmp_path / "drive.msl")
    if is_proposed:  # one beside a log is taken
        (tmp_path / "own.toml").write_text(proposed(open_table(path)))
    table = read_table(path)
    assert table.profile == ("own" if is_proposed else "megasquirt")
    for name, wanted in (
        ("lambda_measured", LAMBDA),
        ("coolant_temperature_degc", D["clt_c"]),
        ("manifold_temperature_degc", D["iat_c"]),
        ("lambda_controller", D["ego_percent"] / 100.0),
        ("lambda_correction_percent", D["ego_percent"] - 100.0),
        ("injector_pulse_width_ms", D["pw_ms"]),
        ("manifold_pressure_kpa", D["map_kpa"]),
    ):
        np.testing.assert_allclose(column(table, name), wanted, rtol=1e-4, atol=1e-3, err_msg=name)
    # the fuel is what the injector lets through after its dead time, longer at a lower voltage
    dead_ms = 1.0 + 0.1 * (14.0 - D["battery_v"])
    np.testing.assert_allclose(
        column(table, "fuel_mass_mg"), 3.0 * np.maximum(D["pw_ms"] - dead_ms, 0.0), atol=1e-2
    )
    # air of the ECU's own table would say nothing, so there is none
    assert "air_mass_mg" not in table.names


@pytest.mark.parametrize("version", [1, 2])
def test_a_rusefi_log_is_recognised_with_its_fuel_cut(tmp_path: Path, version: int) -> None:
    cut = (D["t_s"] > 20.0) & (D["t_s"] < 25.0)
    pw_ms = np.where(cut, 0.0, D["pw_ms"])
    own = D["t_s"], D["rpm"], D["map_kpa"], LAMBDA, pw_ms, D["battery_v"], D["clt_c"]
    values = np.column_stack([*own, D["ego_percent"] - 100.0, cut])
    path = write_mlg(
        tmp_path / "drive.mlg", RUSEFI, values, D["t_s"], version=version, info='"rusEFI x"'
    )
    table = read_table(path)
    assert table.profile == "rusefi"
    np.testing.assert_array_equal(column(table, "fuel_cut"), cut)
    np.testing.assert_allclose(column(table, "lambda_measured"), LAMBDA, atol=1e-4)
    np.testing.assert_array_equal(column(table, "fuel_mass_mg") == 0.0, cut)


def test_no_pulse_is_fuel_cut_and_afr_is_the_sensor_s_in_any_log(tmp_path: Path) -> None:
    columns = {"LogEntrySeconds": D["t_s"], "LogID": D["t_s"], "LogEntryDate": D["t_s"]}
    columns |= {"LogEntryTime": D["t_s"], "RPM": D["rpm"], "O2Sensor2": LAMBDA - 0.5}
    columns |= {"InjPulseWidth": np.where(D["t_s"] < 3.0, 0.0, D["pw_ms"]), "AFR": D["afr"]}
    table = read_table(write_text_table(tmp_path / "a.csv", columns))
    np.testing.assert_array_equal(column(table, "fuel_cut"), D["t_s"] < 2.99)
    np.testing.assert_allclose(column(table, "lambda_measured"), LAMBDA, rtol=1e-4)


def test_every_shipped_profile_is_recognised_by_its_own_columns(tmp_path: Path) -> None:
    for name in shipped():
        profile = shipped_profile(name)
        for each in profile.recognise:
            columns = dict.fromkeys(each.columns or ("Time", "RPM"), D["t_s"])
            path = write_text_table(tmp_path / "a.csv", columns, preamble=[*each.preamble])
            if "%DataLog%" in each.preamble:
                continue  # a format of its own
            found = recognised(open_table(path))
            assert getattr(found, "name", "") == name, each


@pytest.mark.parametrize("name", ["Time", "timestamp"])
def test_a_table_of_canonical_names_may_have_dates(tmp_path: Path, name: str) -> None:
    own, dated = tmp_path / "own.csv", tmp_path / "dated.csv"
    own.write_text("time_s,lambda_measured,engine_speed_rpm\n0,1.1,800\n0.5,0.9,900\n1,1,950\n")
    first = "2026-01-02T03:04:0"
    rows = [f"{first}5.0,1.1,800", f"{first}5.5,0.9,900", f"{first}6.0,1,950"]
    dated.write_text("\n".join([f"{name},lambda_measured,engine_speed_rpm", *rows]) + "\n")
    wanted, found = read_table(own), read_table(dated)
    np.testing.assert_array_equal(found.t_ns - found.t_ns[0], wanted.t_ns)
    for each in wanted.names:
        np.testing.assert_array_equal(column(found, each), column(wanted, each))


def test_haltech_logs_describe_their_channels_before_the_rows(tmp_path: Path) -> None:
    channels = {
        "RPM": ("EngineSpeed", 2000),
        "Manifold Pressure": ("AbsPressure", 1013),
        "Coolant Temperature": ("Temperature", 3631),
        "Wideband Sensor 1": ("AFR", 985),
        "Battery Voltage": ("BatteryVoltage", 13850),
    }
    head = "".join(f"Channel : {n}\nID : 1\nType : {t}\n" for n, (t, _) in channels.items())
    row = ",".join(str(value) for _, value in channels.values())
    rows = "".join(f"23:59:59.{k}00,{row}\n" for k in range(8, 10))
    rows += "".join(f"00:00:00.{k}00,{row}\n" for k in range(5))
    rows += "00:00:00.500,2000,-2147483645,3631,2147483647,8388607\n"  # no values but two
    path = tmp_path / "haltech.csv"
    path.write_text(f"%DataLog%\nDataLogVersion : 1.1\n{head}Log : 20230605 08:41:34\n{rows}00:0")
    table = read_table(path)
    assert table.profile == "haltech"
    assert table.values == pytest.approx(np.array([[101.3, 0.985, 2000.0, 89.95, 13.85]] * 8))
    assert np.diff(table.t_ns).tolist() == [100_000_000] * 7  # on over midnight
    assert table.notes.counts == {"clock_wraps": 1}


@pytest.mark.parametrize("pin", [7.4, 22.3, 25.5, 29.0])
def test_afr_that_pins_is_marked_and_kept(tmp_path: Path, pin: float) -> None:
    # GIVEN a log at uneven steps whose AFR stands at a value that says "no sensor"
    afr = np.where((D["t_s"] > 10.0) & (D["t_s"] < 20.0), pin, D["afr"])
    path = msl(tmp_path / "a.msl", afr)
    lines = path.read_text("cp1252").splitlines(keepends=True)
    path.write_text("".join(x for i, x in enumerate(lines) if i < 4 or i % 7), "cp1252")
    # WHEN it is brought to the grid
    table = read_table(path)
    block = table_block(table, ["lambda_measured"], 100_000_000)
    # THEN these samples are marked, nothing else, and the value is kept
    pinned = block.quality[:, 0] == Quality.PINNED
    t_s = (block.t_ns - block.t_ns[0]) / 1e9
    assert pinned[(t_s > 10.2) & (t_s < 19.8)].all()
    assert not pinned[(t_s < 9.8) | (t_s > 20.2)].any()
    np.testing.assert_allclose(block.values[pinned, 0][2:-2], pin / 14.7, rtol=1e-3)


def test_one_setting_of_units_holds_for_all_columns_without_a_unit(tmp_path: Path) -> None:
    # GIVEN EvoScan set to °F and mph, where 68 would be a plausible temperature in °C, too
    def log(name: str, coolant: float, air: float, speed: float) -> Table:
        columns = {"LogID": D["t_s"], "LogEntryDate": D["t_s"], "LogEntryTime": D["t_s"]}
        columns |= {"LogEntrySeconds": D["t_s"], "RPM": D["rpm"]}
        columns |= {"CoolantTemp": coolant + 0 * LAMBDA, "AirTemp": air + 0 * LAMBDA}
        columns["Speed"] = speed + LAMBDA
        return read_table(write_text_table(tmp_path / name, columns))

    # WHEN the coolant can only be in °F THEN the air is, too, and the speed is in mph
    for table in (log("us.csv", 192.2, 68.0, 50.0), log("si.csv", 89.0, 20.0, 80.4672)):
        assert column(table, "coolant_temperature_degc")[0] == pytest.approx(89.0)
        assert column(table, "manifold_temperature_degc")[0] == pytest.approx(20.0)
        assert column(table, "vehicle_speed_km_h")[0] == pytest.approx(81.5, abs=0.8)


def test_a_column_of_zeros_is_passed_over_for_one_that_lives(tmp_path: Path) -> None:
    path = msl(tmp_path / "a.msl", 0 * D["afr"], Lambda=LAMBDA)
    np.testing.assert_allclose(column(read_table(path), "lambda_measured"), LAMBDA, rtol=1e-4)


def test_uneven_repeated_and_paused_times(tmp_path: Path) -> None:
    # GIVEN rows out of order, with the same time, without one, a pause, and a second log behind
    times = ["0", "0.1", "0.1", "0.05", "", "0.3", "30", "30.1", "0", "0.1"]
    rpm = [str(1000 + i) for i in range(len(times))]
    path = write_text_table(tmp_path / "a.csv", {"Time (msec)": times, "Engine Speed (rpm)": rpm})
    text = path.read_text().replace("(msec)", "(sec)")
    profile = tmp_path / "mine.toml"
    profile.write_text('time = "Time"\n[signals]\nengine_speed_rpm = "Engine Speed"\n')
    path.write_text(text)
    # WHEN it is read
    table = read_table(path, profile)
    # THEN the last of equal times counts, and the second log follows after 10 s
    assert (table.t_ns / 1e9).tolist() == pytest.approx([0, 0.1, 0.3, 30, 30.1, 40.1, 40.2])
    assert table.values[:, 0].tolist() == [1000, 1002, 1005, 1006, 1007, 1008, 1009]
    assert table.notes.counts == {
        "rows_without_time": 1,
        "logs_begun_anew": 1,
        "rows_out_of_order": 1,
        "repeated_times": 1,
    }


def test_a_log_of_an_engine_that_stands_says_which_columns_are_zero(tmp_path: Path) -> None:
    path, profile = tmp_path / "still.csv", tmp_path / "own.toml"
    path.write_text("Time,Speed\n0.0,0\n0.1,0\n0.2,0\n")
    profile.write_text('time = "Time"\n[signals]\nengine_speed_rpm = "Speed"\n')
    with pytest.raises(RecordingError, match="blank, or 0 throughout: Speed; none other is known"):
        read_table(path, profile)


@pytest.mark.parametrize(("step_s", "period_s"), [(0.02, 0.1), (0.198, 0.2), (1.0, 1.0)])
def test_a_slow_uneven_log_has_its_own_grid(tmp_path: Path, step_s: float, period_s: float) -> None:
    t_s = step_s * np.arange(50) + 0.05 * step_s * (np.arange(50) % 2)
    columns = {"Time (msec)": 1000 * t_s, "Engine Speed (rpm)": 900 + t_s}
    path = write_text_table(tmp_path / "a.csv", columns)
    assert table_period_ns(read_table(path)) == round(period_s * 1e9)


def test_a_column_of_a_signal_s_name_in_another_unit_stands_as_a_comment(tmp_path: Path) -> None:
    # GIVEN a sensor's voltage that is called lambda, and a pulse width by its abbreviation
    cells = {"time": D["t_s"], "lambda [V]": LAMBDA, "pw_ms": np.linspace(1.0, 6.0, len(LAMBDA))}
    draft = proposed(open_table(write_text_table(tmp_path / "own.csv", cells)))
    # THEN the one says why it is no lambda, the other is the injectors'
    why = "its unit V is of another quantity: which factor and offset?"
    assert f"# lambda_measured: {why}" in draft
    assert '#   lambda_measured = "lambda [V]"' in draft
    assert '\ninjector_pulse_width_ms = "pw_ms"' in draft


def test_a_logger_that_nobody_knows_is_one_toml_file_and_no_code(tmp_path: Path) -> None:
    # GIVEN a file that no profile knows
    columns = {
        "Zeit": D["t_s"],
        "Drehzahl": D["rpm"],
        "Saugrohrdruck [bar]": D["map_kpa"] / 100.0,
        "Lambda": LAMBDA,
        "Öltemperatur [°C]": np.full(len(LAMBDA), 90.0),
        "Luftmasse [%]": np.full(len(LAMBDA), 20.0),
        "DK": D["map_kpa"],
    }
    path = write_text_table(tmp_path / "neu.csv", columns, separator=";", comma=True)
    with pytest.raises(RecordingError, match=r"no profile knows its columns .*--write-profile"):
        read_table(path)
    # WHEN a profile is proposed, THEN it has the columns whose words, unit and values agree
    draft = proposed(open_table(path))
    assert 'time = ["Zeit"]' in draft
    assert '# "Öltemperatur [°C]" 90 to 90' in draft
    assert '# "Luftmasse [%]" 20 to 20' in draft
    # AND it is edited
    mine, own = tmp_path / "neu.toml", 'ambient_temperature_degc = "Öltemperatur [°C]"'
    mine.write_text(draft.replace("# [engine]", f"{own}\n# [engine]"))
    # THEN the file is read
    table = read_table(path, mine)
    assert set(table.names) == {
        "manifold_pressure_kpa",
        "lambda_measured",
        "engine_speed_rpm",
        "throttle_percent",
        "ambient_temperature_degc",
    }
    np.testing.assert_allclose(column(table, "manifold_pressure_kpa"), D["map_kpa"], rtol=1e-4)


def test_an_own_profile_beside_the_log_or_in_the_user_s_folder_is_recognised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a log that a shipped profile knows, and an own profile for E85 in the user's folder
    folder, drives = tmp_path / "profiles", tmp_path / "drives"
    folder.mkdir()
    drives.mkdir()
    log = msl(drives / "a.msl")
    part = 'based_on = "megasquirt"\nstoich_afr = 9.0\n[engine]\ninjector_mg_per_ms = 6\n'
    (folder / "e85.toml").write_text(part)
    assert load_profile(folder / "e85.toml").engine.injector_mg_per_ms == 6.0
    assert read_table(log).profile == "megasquirt"
    monkeypatch.setenv("O2_PROFILES", str(folder))
    table = read_table(log)
    assert table.profile == "e85"
    np.testing.assert_allclose(column(table, "lambda_measured"), D["afr"] / 9.0, rtol=1e-4)
    # WHEN another one stands beside the log, with files that are no profiles
    (drives / "map.toml").write_text('time_s = "Time"\n')
    shutil.copy(dbc.path("o2_ecu.toml"), drives / "bus.toml")  # map of a bus's messages
    (drives / "race.toml").write_text('based_on = "megasquirt"\nstoich_afr = 6.4\n')
    # THEN it comes first, and check says where it is
    table = read_table(log)
    assert table.profile == "race"
    np.testing.assert_allclose(column(table, "lambda_measured"), D["afr"] / 6.4, rtol=1e-4)
    assert any("your own of" in line and "race.toml" in line for line in check_table(log).header)
    # AND one that cannot be used costs the logs beside it a note, no more
    (drives / "race.toml").write_text('based_on = "megasquirt"\nstoich_afr = "E85"\n')
    table = read_table(log)
    assert table.profile == "e85"
    assert "race.toml: stoich_afr" in table.notes.lines[0]


def test_an_own_profile_reads_a_table_whose_time_is_called_as_in_an_own_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a logger's table with the column time_s, which no model can judge
    cells = {"time_s": D["t_s"], "rpm": D["rpm"], "lambda": LAMBDA}
    log = write_text_table(tmp_path / "log.csv", cells)
    assert main(["replay", str(log)]) == 2
    assert f"'o2mon check {log} --write-profile FILE' proposes" in capsys.readouterr().err
    # WHEN the proposed profile stands beside it THEN it is read with that
    (tmp_path / "own.toml").write_text(proposed(open_table(log)))
    assert read_table(log).names == ("lambda_measured", "engine_speed_rpm")
    assert main(["replay", str(log)]) == 3
    assert main(["check", str(log)]) == 0


def test_low_pressure_is_no_fuel_cut_where_a_pulse_width_says_otherwise(tmp_path: Path) -> None:
    # GIVEN an engine that keeps injecting at 12 kPa in the first seconds, as many builds do
    low = np.where(D["t_s"] < 3.0, 12.0, 60.0)
    columns = {"Time (msec)": 1000.0 * D["t_s"], "Engine Speed (rpm)": np.full_like(low, 2500.0)}
    columns |= {"Manifold Absolute Pressure (kPa)": low}
    cut = column(read_table(write_text_table(tmp_path / "a.csv", columns)), "fuel_cut")
    assert cut.any()
    # WHEN the log has the pulse width, too
    columns |= {"Fuel Injector #1 Pulse Width (ms)": np.full_like(low, 1.4)}
    table = read_table(write_text_table(tmp_path / "b.csv", columns))
    # THEN it counts
    assert not column(table, "fuel_cut").any()


def test_a_profile_in_a_model_card_is_the_same_profile_again() -> None:
    for name in shipped():
        profile = shipped_profile(name)
        again = profile_of(json.loads(json.dumps(tree_of(profile))), Path(f"{name}.toml"))
        assert again == replace(profile, recognise=())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[signals]\nlamda = 'x'\n", "lamda is no canonical signal"),
        ("[signals]\nlambda_measured = { colum = 'x' }\n", "unknown key 'colum'"),
        ("[signals]\nlambda_measured = { column = 'x', factor = 'a' }\n", "a number is wanted"),
        ("stoich = 14\n[signals]\n", "unknown key 'stoich', known are"),
        ("[signals]\n[engine]\ncylinders = 0\n", "cylinders is 0, above 0"),
        ("based_on = 'nobody'\n", "no profile nobody"),
        ("[signals]\nfuel_cut = { column = 'x', bit = -1 }\n", "a whole number from 0"),
    ],
)
def test_a_profile_that_cannot_be_is_refused(tmp_path: Path, text: str, message: str) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_profile(mine)
    assert "mine.toml" in str(caught.value) or "nobody" in str(caught.value)


def test_real_logs_are_recognised_and_give_a_lambda(shared_data: Path) -> None:
    wanted = {
        "wrx_cobb": ("cobb", "lambda_measured", 0.95, 1.02),
        "mx5_megasquirt": ("megasquirt", "lambda_measured", 0.85, 1.0),
        "golf_torque": ("torque", "lambda_measured", 0.98, 1.01),
        "evo_evoscan": ("evoscan", "coolant_temperature_degc", 85.0, 95.0),
    }
    for name, (profile, signal, low, high) in wanted.items():
        for path in sorted((shared_data / "logs" / name).iterdir()):
            table = read_table(path)
            assert table.profile == profile
            assert low < np.nanmedian(column(table, signal)) < high


def test_a_logger_that_asks_for_one_signal_after_the_other_leaves_cells_blank(
    tmp_path: Path,
) -> None:
    # GIVEN a log in which each row holds one column in three, and a sensor silent for 3 s
    own = {"RPM": D["rpm"], "MAP": D["map_kpa"], "AFR": D["afr"], "PW": D["pw_ms"]}
    polled: dict[str, list[str]] = {"Time": [f"{t:.3f}" for t in D["t_s"]]}
    for i, (name, values) in enumerate(own.items()):
        silent = range(300, 330) if name == "AFR" else range(0)
        polled[name] = [
            f"{x:.6g}" if k % 3 == i % 3 and k not in silent else "" for k, x in enumerate(values)
        ]
    log = write_text_table(tmp_path / "polled.csv", polled, units=["s", "rpm", "kPa", "AFR", "ms"])
    profile = tmp_path / "own.toml"
    profile.write_text(
        'time = "Time"\n[signals]\nengine_speed_rpm = "RPM"\nmanifold_pressure_kpa = "MAP"\n'
        'lambda_measured = "AFR"\ninjector_pulse_width_ms = "PW"\n'
    )
    # WHEN it is read
    table = read_table(log, profile)
    # THEN values are held, and signals made of two columns are there
    assert np.isfinite(column(table, "fuel_mass_mg")[3:]).all()
    assert np.isfinite(column(table, "fuel_cut")[3:]).all()
    # AND a silence of more than three intervals stays one
    blank = np.flatnonzero(np.isnan(column(table, "lambda_measured")[3:])) + 3
    assert list(blank) == list(range(blank[0], 330 + (2 - 330 % 3)))
    assert 300 + 5 <= blank[0] <= 300 + 10
    # AND the check tells how often values really come
    (line,) = (x for x in check_table(log, profile).lines() if x.startswith("lambda_measured"))
    assert " 3.1" in line or " 3.2" in line


def test_a_damaged_cell_does_not_tell_the_unit_of_all_times(tmp_path: Path) -> None:
    times = [f"{t:.3f}" for t in D["t_s"]]
    times[100] = "4.2e17"
    log = write_text_table(tmp_path / "drive.csv", {"Time": times, "RPM": D["rpm"]})
    profile = tmp_path / "own.toml"
    profile.write_text('time = "Time"\n[signals]\nengine_speed_rpm = "RPM"\n')
    table = read_table(log, profile)
    assert (table.t_ns - table.t_ns[0]) / 1e9 == pytest.approx(np.delete(D["t_s"], 100))
    assert "1 row without a time left out" in table.notes.lines


def test_a_blank_cell_is_held_and_an_infinite_one_stays() -> None:
    t_ns = np.arange(4) * 100_000_000
    cells = np.array([[1.0, 1.0], [np.inf, np.nan], [2.0, np.nan], [np.nan, 3.0]])
    assert held(cells, t_ns).tolist() == [[1.0, 1.0], [np.inf, 1.0], [2.0, 1.0], [2.0, 3.0]]


def test_values_out_of_range_are_told_with_what_was_wanted(tmp_path: Path) -> None:
    # GIVEN a boost gauge under the name of an absolute pressure, and lambda in percent
    cells = {"Time": D["t_s"], "MAP": D["map_kpa"] - 101.3, "L": 100.0 * LAMBDA}
    log = write_text_table(tmp_path / "drive.csv", cells, units=["s", "kPa", ""])
    profile = tmp_path / "own.toml"
    profile.write_text(
        'time = "Time"\n[signals]\nmanifold_pressure_kpa = "MAP"\nlambda_measured = "L"\n'
    )
    pressure, reading = (
        next(x for x in check_table(log, profile).lines() if x.startswith(name))
        for name in ("manifold_pressure_kpa", "lambda_measured")
    )
    assert ", wanted 5 to 350; a gauge pressure? offset = 101.3 in a profile)" in pressure
    assert f"out of range ({100 * LAMBDA.min():.4g} to {100 * LAMBDA.max():.4g}, wanted" in reading


@pytest.mark.parametrize(
    ("unit", "source"),
    [
        ("psi", 'unit = "psig"'),
        ("psig", 'unit = "psi", offset = 101.325'),
        ("psi gauge", 'unit = "kPa"'),
    ],
)
def test_a_gauge_s_pressure_is_counted_from_the_air_once(
    tmp_path: Path, unit: str, source: str
) -> None:
    # WHEN file, profile or both say that a pressure is a gauge's
    gauge = (D["map_kpa"] - 101.325) / 6.894757
    path, profile = tmp_path / "a.csv", tmp_path / "a.toml"
    write_text_table(path, {"Time": D["t_s"], f"Boost ({unit})": gauge})
    told = f'manifold_pressure_kpa = {{ column = "Boost", {source} }}'
    profile.write_text(f'time = "Time"\n[signals]\n{told}\n')
    # THEN the air's pressure is added once
    np.testing.assert_allclose(read_table(path, profile).values[:, 0], D["map_kpa"], atol=0.02)


@pytest.mark.parametrize(
    ("unit", "offset_kpa", "is_taken"),
    [
        *[("kPa", 101.3, True), ("kPa", 0.0, False), ("bar", 0.0, False), ("PSI", 0.0, False)],
        *[("PSI", 101.3, True), ("psi", 33.0, True)],  # of a pull from the air's pressure on
    ],
)
def test_a_boost_is_a_gauge_s_only_if_it_falls_to_the_air_s_pressure(
    tmp_path: Path, unit: str, offset_kpa: float, is_taken: bool
) -> None:
    # GIVEN a logger whose boost is a gauge pressure in psi, and a file that has it in kPa or bar
    boost = (D["map_kpa"] - offset_kpa) / {"bar": 100.0, "kPa": 1.0}.get(unit, 6.894757)
    cells = {"Time (sec)": D["t_s"], "RPM (RPM)": D["rpm"], f"Boost ({unit})": boost}
    path = tmp_path / "drive.csv"
    # WHEN the shipped profile reads it, and the draft
    write_text_table(path, cells | {"AF Sens 1 Ratio": 14.7 * LAMBDA, "AP Info": LAMBDA})
    table, draft = read_table(path, "cobb"), proposed(open_table(path))
    # THEN pressures that never fall below 0 may be absolute and are not taken
    assert ("manifold_pressure_kpa" in table.names) == is_taken
    assert ("\nmanifold_pressure_kpa" in draft) == is_taken
    told = [line for line in table.notes.lines if "a gauge pressure or an absolute one?" in line]
    assert bool(told) != is_taken


def test_of_a_gauge_and_an_absolute_pressure_the_draft_takes_the_absolute(tmp_path: Path) -> None:
    gauge = (D["map_kpa"] - 101.3) / 6.894757
    cells = {"Time": D["t_s"], "Boost (psi)": gauge, "RPM": D["rpm"], "MAP (kPa)": D["map_kpa"]}
    draft = proposed(open_table(write_text_table(tmp_path / "drive.csv", cells)))
    assert 'manifold_pressure_kpa = "MAP (kPa)"' in draft
    del cells["MAP (kPa)"]
    draft = proposed(open_table(write_text_table(tmp_path / "gauge.csv", cells)))
    assert 'column = "Boost (psi)", unit = "psi", offset = 101.3' in draft
    # AND one whose values cannot be what its name and unit say stays a comment
    cells |= {"MAP (psi)": cells.pop("Boost (psi)"), "AFR (AFR)": LAMBDA}
    draft = proposed(open_table(write_text_table(tmp_path / "other.csv", cells)))
    assert not [line for line in draft.splitlines() if line.startswith(("manifold_", "lambda_"))]
