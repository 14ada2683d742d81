"""Tables as tools write them: headers of several rows, settings above, own times, units."""

import gzip
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from monitor import cli
from monitor.base.errors import O2Error, RecordingError
from monitor.grid.tables import Table, read_table

ROWS = range(40)
RPM = [1500 + 20 * i for i in ROWS]
AIR = [10.0 + 0.5 * i for i in ROWS]  # g/s
AFR = [14.0 + 0.03 * i for i in ROWS]


def rows(form: Callable[[int], str]) -> str:
    return "".join(form(i) + "\n" for i in ROWS)


TABLES = {
    "three rows of header": (
        "Logfile of a tool\n\nTime , nmot_w , mshfm_w , lamsoni_w\n s , rpm , g/s , - \n"
        '"TIME","EngineSpeed","MassAirFlow","AirFuelRatioCurrent"\n'
        + rows(lambda i: f"{i / 10}, {RPM[i]}, {AIR[i]}, {AFR[i] / 14.7:.4f}"),
        {"engine_speed_rpm": "nmot_w", "maf_kg_h": "mshfm_w", "lambda_measured": "lamsoni_w"},
    ),
    "sections": (
        "A Log File\nVersion: 1.0\n\n[Channel Information]\n0,12,5,9\nOffset,RPM,Air,A2 Wideband\n"
        "s,rpm,g/s,AFR\n\n[Channel Data]\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},{AIR[i]},{AFR[i]}"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "A2 Wideband"},
    ),
    "short names and numbers of the channels": (
        ",RPM,LA1,AIR,LAP\nTime,Engine RPM,Lambda 1,Air,Lap\ns,rpm,LA,g/s,\n,4097,8200,4100,1\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i] / 14.7},{AIR[i]},1"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "LA1"},
    ),
    "numbers of the columns": (
        "Time,RPM,AFR,Lambda\ns,rpm,,lambda\n1,2,3,4\n"  # a gauge set to another fuel
        + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i] * 0.9},{AFR[i] / 14.7}"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "Lambda"},
    ),
    "settings above the table": (
        "Firmware,Engine,Gain,,\n4/15,X,0,,\nSafety,PID,Fuel,,\n28,10,60,,\n"
        "timestamp,rpm,afr,air,boost\n" + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i]},{AIR[i]},1"),
        {"engine_speed_rpm": "rpm", "lambda_measured": "afr"},
    ),
    "a row of groups wider than the table": (
        "05L 906 022 F,ABC,\n,,G004,F0,G008,F0,\n\nMarker,TIME,Loc. 1,TIME,Loc. 2,\n"
        ",STAMP,Engine RPM,STAMP,Lambda,\n,, /min,, -,\n"
        + rows(lambda i: f",{i / 10},{RPM[i]},{i / 10},{AFR[i] / 14.7},"),
        {"engine_speed_rpm": "Loc. 1", "lambda_measured": "Loc. 2"},
    ),
    "units in brackets": (
        "Session: 8,,,\ntime,LC1,RPM,X\n(sec),(AFR),(RPM),(g/s)\n"
        + rows(lambda i: f"{i / 10},{AFR[i]},{RPM[i]},{AIR[i]}"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "LC1"},
    ),
    "codes above the names": (
        ",SAE.RPM,SAE.MAF,SAE.MAF,O2S\nFrame Time (h:m:s.ms),Engine RPM (rpm),Air Flow (lb/min),"
        "Mass Air Flow (g/s),O2 Sensor 1 Lambda\n"
        + rows(
            lambda i: f"0:00:0{i / 10:.3f},{RPM[i]},{AIR[i] * 0.13228},{AIR[i]},{AFR[i] / 14.7:.4f}"
        ),
        {"engine_speed_rpm": "Engine RPM (rpm)", "lambda_measured": "O2 Sensor 1 Lambda"},
    ),
    "another alphabet": (
        "Время (с),Обороты двигателя (об/мин),Лямбда\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i] / 14.7:.4f}"),
        {"engine_speed_rpm": "Обороты двигателя (об/мин)", "lambda_measured": "Лямбда"},
    ),
    "a comma in thousands that is no decimal one": (
        "Time,RPM,AFR\n" + rows(lambda i: f'{i / 10},"{RPM[i]:,}",{AFR[i]:.2f}'),
        {"engine_speed_rpm": "RPM", "lambda_measured": "AFR"},
    ),
    "a decimal comma with an exponent": (
        "t;RPM;AFR\ns;1/min;AFR\n"
        + rows(lambda i: f"{i / 10:.3E};{RPM[i]};{AFR[i]:.4E}".replace(".", ",")),
        {"engine_speed_rpm": "RPM", "lambda_measured": "AFR"},
    ),
    "many settings above the table": (
        "".join(f"Setting {i},{i}\n" for i in range(99))
        + "Time,RPM,Lambda\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i] / 14.7}"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "Lambda"},
    ),
    "blank rows below the names": (
        "Time,RPM,Lambda\n"
        + ",,\n" * 30
        + rows(lambda i: f"00:00:0{i / 10},{RPM[i]},{AFR[i] / 14.7}"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "Lambda"},
    ),
    "a separator at the ends of the rows alone": (
        "Time,RPM,AFR\n" + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i]},"),
        {"engine_speed_rpm": "RPM", "lambda_measured": "AFR"},
    ),
    "names with their units, ranges and rates": (
        '"Interval"|"ms"|0|0|1,"RPM"|"rpm"|0.0|9000.0|10,"AFR"|"AFR"|7.0|22.0|5\n'
        + rows(lambda i: f"{100 * i},{RPM[i]},{AFR[i]}"),
        {"engine_speed_rpm": 'RPM|"rpm"|0.0|9000.0|10'},
    ),
    "units above the names": (
        "s,rpm,AFR,mph\nTime,RPM,AFR,Speed\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i]},{40 + i % 9}"),
        {"engine_speed_rpm": "RPM", "vehicle_speed_km_h": "Speed"},
    ),
    "points in thousands beside decimal commas": (
        "Zeit [ms];Motordrehzahl [1/min];Lambda\n"
        + rows(lambda i: f"{100 * i:,};{RPM[i]:,};".replace(",", ".") + f"{AFR[i] / 14.7:.4f}")
        .replace(";0.", ";0,")
        .replace(";1.0", ";1,0"),
        {"engine_speed_rpm": "Motordrehzahl [1/min]"},
    ),
    "blanks in thousands": (
        "Temps (s);Régime moteur (tr/min);AFR\n"
        + rows(lambda i: f"{i / 10};{RPM[i] // 1000} {RPM[i] % 1000:03d};{AFR[i]}"),
        {"engine_speed_rpm": "Régime moteur (tr/min)", "lambda_measured": "AFR"},
    ),
    "LabVIEW's headers, lines of tabs, and remarks that rows lack": (
        "Date\t2026/11/28\n***End_of_Header***\t\n\t\t\nDate\t2026/11/28\t2026/11/28\nX0\t0.0\t0.0\n"
        "***End_of_Header***\t\t\nX_Value\tEngine Speed\tLambda\tComment\n"
        + rows(lambda i: f"{i / 10}\t{RPM[i]}\t{AFR[i] / 14.7:.4f}" + "\twarm" * (i == 5)),
        {"engine_speed_rpm": "Engine Speed"},
    ),
    "one name for volts and for the quantity, and roles in brackets": (
        "Time,RPM,MAP,MAP,Lambda (actual),Lambda (specified)\ns,rpm,V,kPa,-,-\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},2.1,{40 + i % 9},{AFR[i] / 14.7:.4f},0.97"),
        {"manifold_pressure_kpa": "MAP#2", "lambda_target": "Lambda (specified)"},
    ),
    "padded cells": (
        "TimeStamp; nmot_w    ; mshfm_w   ; lamsoni_w\n  sec.ms ; rpm       ; g/s       ; -\n"
        + rows(lambda i: f"    {i / 10:.3f}; {RPM[i]}      ; {AIR[i]}  ; {AFR[i] / 14.7:.5f}"),
        {"engine_speed_rpm": "nmot_w", "maf_kg_h": "mshfm_w", "lambda_measured": "lamsoni_w"},
    ),
    "measurements with key, name and value": (
        "Zeitstempel;Laufzeit_s;Schlüssel;Messwert;Wert;Einheit\n"
        + rows(
            lambda i: (
                f"10:00:0{i / 10};{i / 10};n;Motordrehzahl;{RPM[i]};1/min\n"
                f"10:00:0{i / 10 + 0.02};{i / 10 + 0.02};l;Lambda;{AFR[i] / 14.7};"
            )
        ),
        {"engine_speed_rpm": "Motordrehzahl", "lambda_measured": "Lambda"},
    ),
    "fields of a database": (
        ",result,_time,_value,_field\n"
        + rows(lambda i: f",0,2026-06-25T20:03:{i:02d}.1Z,{RPM[i]},rpm")
        + rows(lambda i: f",0,2026-06-25T20:03:{i:02d}.1Z,{AFR[i] / 14.7},lambda"),
        {"engine_speed_rpm": "rpm", "lambda_measured": "lambda"},
    ),
    "a database's annotated fields, one after another": (
        "".join(
            f"#group,false,true,false\n#datatype,string,time,string\n#default,_result,,\n"
            f",result,_start,_time,_value,_field\n{lines}\n"
            for lines in (
                rows(lambda i: f",,2026-06-25T20:00:00Z,2026-06-25T20:03:{i:02d}Z,{RPM[i]},rpm"),
                rows(lambda i: f",,2026-06-25T20:00:00Z,2026-06-25T20:03:{i:02d}Z,{AFR[i]},afr"),
            )
        ),
        {"engine_speed_rpm": "rpm", "lambda_measured": "afr"},
    ),
    "states of a home": (
        "entity_id,state,last_changed\n"
        + rows(
            lambda i: (
                f"sensor.obd_rpm,{RPM[i]},2026-12-01T10:00:{i:02d}.000Z\n"
                f"sensor.obd_lambda,{AFR[i] / 14.7},2026-12-01T10:00:{i:02d}.020Z"
            )
        ),
        {"engine_speed_rpm": "sensor.obd_rpm", "lambda_measured": "sensor.obd_lambda"},
    ),
    "units in words behind the values": (
        "timestamp,RPM,MAF,LAMBDA\n"
        + rows(
            lambda i: (
                f"10:00:{i:02d}.0,{RPM[i]} revolutions_per_minute,{AIR[i]} gram / second,"
                f"{AFR[i] / 14.7} ratio"
            )
        ),
        {"engine_speed_rpm": "RPM", "maf_kg_h": "MAF", "lambda_measured": "LAMBDA"},
    ),
    "topics of a broker": (
        "topic,timestamp,payload\n"
        + rows(
            lambda i: (
                f"car/Engine RPM,2026-06-25 20:03:{i:02d}.02+00:00,{RPM[i]}\n"
                f"car/door,2026-06-25 20:03:{i:02d}.04+00:00,open\n"
                f"car/Lambda,2026-06-25 20:03:{i:02d}.06+00:00,{AFR[i] / 14.7}"
            )
        ),
        {"engine_speed_rpm": "car/Engine RPM", "lambda_measured": "car/Lambda"},
    ),
    "one value a row": (
        '"SECONDS";"PID";"VALUE";"UNITS";\n'
        + rows(
            lambda i: (
                f'"{i / 10}";"Engine RPM";"{RPM[i]}";"rpm"\n'
                f'"{i / 10 + 0.02}";"Mass Air Flow";"{AIR[i]}";"g/s"\n'
                f'"{i / 10 + 0.05}";"O2 Sensor 1 Wide Range Equivalence ratio";"{AFR[i] / 14.7}";""'
            )
        ),
        {
            "engine_speed_rpm": "Engine RPM",
            "lambda_measured": "O2 Sensor 1 Wide Range Equivalence ratio",
        },
    ),
}


Proposed = Callable[..., tuple[Table, dict[str, str]]]


@pytest.fixture
def proposed(tmp_path: Path) -> Proposed:
    """Give what reads a text with the profile proposed for it, and the profile's columns."""

    def read(text: str, encoding: str = "utf-8") -> tuple[Table, dict[str, str]]:
        path, profile = tmp_path / "drive.csv", tmp_path / "drive.toml"
        path.write_text(text, encoding)
        assert cli.main(["check", str(path), "--write-profile", str(profile), "--force"]) == 0
        signals = tomllib.loads(profile.read_text())["signals"]
        columns = {k: v["column"] if isinstance(v, dict) else v for k, v in signals.items()}
        return read_table(path, profile), columns

    return read


def values(table: Table, name: str) -> np.ndarray:
    found = table.values[:, table.names.index(name)]
    return found[np.isfinite(found)]


@pytest.mark.parametrize("name", TABLES)
def test_the_proposed_profile_reads_names_and_units(proposed: Proposed, name: str) -> None:
    text, wanted = TABLES[name]
    table, columns = proposed(text)
    assert wanted.items() <= columns.items()
    np.testing.assert_allclose(np.unique(values(table, "engine_speed_rpm")), RPM)
    seen = np.unique(np.round(values(table, "lambda_measured"), 3))
    np.testing.assert_allclose(seen, np.round(np.array(AFR) / 14.7, 3), atol=2e-3)


@pytest.mark.parametrize("encoding", ["cp1250", "utf-8"])
@pytest.mark.parametrize(
    "names", ["Otáčky motoru;Rychlost vozidla", "Prędkość obrotowa silnika;Prędkość pojazdu"]
)
def test_letters_of_central_europe_are_read(proposed: Proposed, names: str, encoding: str) -> None:
    text = f"Čas;{names}\ns;1/min;km/h\n" + rows(lambda i: f"{i / 10};{RPM[i]};{40 + i % 9}")
    _, columns = proposed(text, encoding)
    assert ";".join(columns[n] for n in ("engine_speed_rpm", "vehicle_speed_km_h")) == names


def test_groups_with_clocks_of_their_own_keep_their_times(proposed: Proposed) -> None:
    # GIVEN two groups of columns, the second logged 0.3 s after the first
    # WHEN the proposed profile reads it
    table, columns = proposed(
        "Friday,1,May\n,Group A:,'003,,Group B:,'033,\n,,RPM,Mass Flow,,Lambda,\n,TIME,,,TIME,,\n"
        "Marker,STAMP,/min,g/s,STAMP,,\n"
        + rows(lambda i: f",{i / 2},{RPM[i]},{AIR[i]},{i / 2 + 0.3},{0.9 + i / 200},")
    )
    assert columns == {
        "engine_speed_rpm": "RPM",
        "maf_kg_h": "Mass Flow",
        "lambda_measured": "Lambda",
    }
    # THEN a row has the last value that its time had seen
    assert values(table, "engine_speed_rpm").tolist() == RPM
    np.testing.assert_allclose(values(table, "lambda_measured"), [0.9 + i / 200 for i in ROWS[:-1]])


@pytest.mark.parametrize(
    ("names", "form"),
    [
        ("t,RPM,T1,AFR,T2", "{},{},{},{},0"),
        ("t,RPM,t_oil,AFR", "{},{},{},{}"),
        ("Time,RPM,Time to shift,AFR", "{},{},-{},{}"),
        ("Time,RPM,Vehicle,AFR", "{},{},{},{}"),
    ],
)
def test_signals_named_like_a_clock_or_a_source_are_signals(
    proposed: Proposed, names: str, form: str
) -> None:
    cells = ((i / 10, RPM[i], 80 + i // 20, AFR[i]) for i in ROWS)
    table, _ = proposed(f"{names}\n" + "".join(form.format(*each) + "\n" for each in cells))
    np.testing.assert_allclose(values(table, "lambda_measured"), np.array(AFR) / 14.7)


@pytest.mark.parametrize("names", [("X1 [s]", "X2 [s]"), ("t_rpm", "t_lambda"), ("Time", "Time")])
def test_columns_with_a_clock_each_keep_their_times(
    proposed: Proposed, names: tuple[str, str]
) -> None:
    # GIVEN a sensor that is logged from 1 s on at half the rate, and ends in the middle
    table, _ = proposed(
        f"{names[0]},RPM,{names[1]},Lambda\n"
        + rows(
            lambda i: f"{i / 10},{RPM[i]}," + (f"{1 + i / 20},{0.9 + i / 1000}" if i < 20 else ",")
        )
    )
    # THEN each value stands at its time, and is not held to the end
    measured = [0.9 + i / 1000 for i in (*range(0, 20, 2), *[19] * 6)]
    np.testing.assert_allclose(values(table, "lambda_measured"), measured)


@pytest.mark.parametrize(
    ("names", "form"),
    [
        ("Seconds,Microseconds", lambda ms: f"{1795847400 + ms // 1000},{ms % 1000 * 1000}"),
        ("secs,nsecs", lambda ms: f"{ms // 1000},{ms % 1000 * 1_000_000}"),
        ("Time,Millisecond", lambda ms: f"10:00:{ms // 1000:02d},{ms % 1000}"),
        (
            "Year,Month,Day,Hour,Minute,Second",
            lambda ms: f"2026,11,28,10,{(57000 + ms) // 60000},{(57000 + ms) % 60000 / 1000:.3f}",
        ),
        ("Hour,Minute,Second,ms", lambda ms: f"9,59,{ms // 1000},{ms % 1000}"),
        ("Seconds,Milliseconds", lambda ms: f"{ms // 1000},{ms}"),  # each tells all of it
    ],
)
def test_a_time_may_stand_in_several_columns(
    proposed: Proposed, names: str, form: Callable[[int], str]
) -> None:
    times_ms = [130 * i + 7 * (i % 3) for i in ROWS]
    table, _ = proposed(
        f"{names},RPM,AFR\n" + rows(lambda i: f"{form(times_ms[i])},{RPM[i]},{AFR[i]}")
    )
    atol = 5e8 if form(1234) == "1,1234" else 1e3  # whole seconds, spread
    np.testing.assert_allclose(np.diff(table.t_ns), np.diff(times_ms) * 1e6, atol=atol)


def test_a_clock_that_goes_back_an_hour_goes_on(proposed: Proposed) -> None:
    text = rows(
        lambda i: f"2026-10-25 02:{59 * (i < 20):02d}:{(58 + i / 10) % 60:04.1f},{RPM[i]},{AFR[i]}"
    )
    table, _ = proposed("Time,RPM,AFR\n" + text)
    np.testing.assert_allclose(np.diff(table.t_ns), 1e8, atol=1e6)
    assert any("the clock started again" in line for line in table.notes.lines)


def test_a_column_whose_unit_is_of_another_quantity_carries_no_signal(tmp_path: Path) -> None:
    # GIVEN each quantity in volts and in its own unit, under one name
    path = tmp_path / "volts.csv"
    path.write_text(
        "Time (msec),Engine Speed (rpm),Mass Airflow (V),Mass Airflow (g/s),AEM UEGO Wideband (V),"
        "AEM UEGO Wideband (AFR),Engine Load (%)\n"
        + rows(lambda i: f"{100 * i},{RPM[i]},1.5,{AIR[i]},2.2,{AFR[i]},54")
    )
    table = read_table(path)
    # THEN the one whose unit converts is taken, and a load in percent is none in g per revolution
    np.testing.assert_allclose(values(table, "lambda_measured"), np.array(AFR) / 14.7)
    np.testing.assert_allclose(values(table, "maf_kg_h"), 3.6 * np.array(AIR))
    assert "load_g_per_rev" not in table.names
    assert any(
        "Engine Load (%) is left out: its unit % does not suit" in line
        for line in table.notes.lines
    )


@pytest.mark.parametrize(
    ("column", "cells", "signal"),
    [
        ("Fuel Lambda Mod", "1", "lambda_measured"),  # a correction
        ("Lambda", "1", "lambda_measured"),  # a constant
        ("MAF Req [g/s]", "", "maf_kg_h"),  # commanded
        ("Speed", "", "vehicle_speed_km_h"),  # km/h or mph?
        ("Vehicle Speed", "", "vehicle_speed_km_h"),  # whatever other loggers mean by it
        ("Vehicle speed (furlongs)", "", "vehicle_speed_km_h"),  # a known name with a new unit
        ("Airmass (bananas/stk)", "", "air_mass_mg"),  # a unit that nobody knows
    ],
)
def test_no_other_column_is_proposed(tmp_path: Path, column: str, cells: str, signal: str) -> None:
    path, out = tmp_path / "drive.csv", tmp_path / "drive.toml"
    path.write_text(f"Time,RPM,{column}\n" + rows(lambda i: f"{i / 10},{RPM[i]},{cells or AIR[i]}"))
    assert cli.main(["check", str(path), "--write-profile", str(out)]) == 0
    assert signal not in tomllib.loads(out.read_text())["signals"]


def test_a_repeated_header_with_other_units_ends_the_table(proposed: Proposed) -> None:
    # GIVEN a logger that was set from °C to °F while it logged
    half = "".join(f"{i / 10},{RPM[i]},{88 + i / 99:.2f}\n" for i in range(20))
    header = "Time,RPM,Coolant\ns,rpm,[{}]\n"
    table, _ = proposed(
        header.format("°C") + half + header.format("°C") + half + header.format("°F") + half
    )
    assert len(table.t_ns) == 40
    assert "read up to a header with another unit of Coolant" in table.notes.lines


def test_a_unit_that_nobody_knows_is_one_in_a_row_of_units_too(
    proposed: Proposed, tmp_path: Path
) -> None:
    # GIVEN a pressure in an unknown unit, under a name that draft or shipped profile know
    body = rows(lambda i: f"{i / 10},{RPM[i]},{40 + i % 9},{AFR[i]},0")
    # WHEN the draft reads it THEN it gives no line
    table, _ = proposed("Time,RPM,MAP,AFR,X\ns,rpm,furlong,AFR,-\n" + body)
    assert set(table.names) == {"engine_speed_rpm", "lambda_measured"}
    # AND neither does the shipped profile, which says so
    path = tmp_path / "known.csv"
    path.write_text("Time (sec),RPM,Boost,AF Sens 1 Ratio,AP Info\ns,rpm,zorks,AFR,-\n" + body)
    table = read_table(path)
    assert "manifold_pressure_kpa" not in table.names
    assert any("Boost is left out: its unit zorks" in line for line in table.notes.lines)


def test_a_name_that_stands_twice_is_told(proposed: Proposed) -> None:
    table, _ = proposed("Time,RPM,AFR,AFR\n" + rows(lambda i: f"{i},{RPM[i]},{AFR[i]},14.7"))
    assert table.notes.lines == ("of the columns AFR and AFR#2 the first is taken",)


def test_a_column_that_is_not_taken_says_why(tmp_path: Path) -> None:
    path, out = tmp_path / "drive.csv", tmp_path / "drive.toml"
    path.write_text("Time,RPM,AFR (AFR)\n" + rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i] / 1.5}"))
    assert cli.main(["check", str(path), "--write-profile", str(out)]) == 0
    assert "# lambda_measured: unusual: its median is 0.6615 (another fuel?)" in out.read_text()


def test_a_median_that_no_running_engine_has_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a logger's file without units, whose pressure is in inHg and mixture that of E85
    path = tmp_path / "drive.csv"
    path.write_text(
        "Time,SecL,RPM,MAP,AFR,EGO cor1,PW,MAT\n"
        + rows(lambda i: f"{i / 10},{i},{RPM[i]},{14 + i / 99},{AFR[i] / 1.5},100,3,25")
    )
    assert cli.main(["check", str(path)]) == 0
    said = capsys.readouterr().out
    assert "manifold_pressure_kpa: a median of 14.2 is unusual for an engine that runs" in said
    assert "lambda_measured: a median of 0.6615 is unusual" in said


def test_a_counter_of_rows_is_no_time(proposed: Proposed) -> None:
    table, _ = proposed(
        "Frame,Duration,RPM,A/F Ratio\n0,281.8,1500,14.7\n"
        + rows(lambda i: f"{(i + 1) % 32},{(i + 1) / 10},{RPM[i]},{AFR[i]}")
    )
    np.testing.assert_allclose(np.diff(table.t_ns), 1e8)
    assert len(table.t_ns) == len(ROWS)  # the old first row is left out, and told
    assert any("1 row older" in line for line in table.notes.lines)


def test_one_row_with_a_damaged_time_costs_itself_alone(proposed: Proposed) -> None:
    odd = {10: 5000, 20: "1e999", 30: 0}
    text = "Time,RPM,AFR\n" + rows(lambda i: f"{odd.get(i, i / 10)},{RPM[i]},{AFR[i]}")
    table, _ = proposed(text)
    assert len(table.t_ns) == len(ROWS) - 3
    assert table.t_ns[-1] == 3_900_000_000
    assert "2 rows older than one before left out" in table.notes.lines


def test_neither_a_speed_that_rises_nor_a_distance_is_the_time(proposed: Proposed) -> None:
    with pytest.raises(RecordingError, match=r"no column of time \(none named\)"):
        proposed("Duration,RPM,Run (km)\n" + rows(lambda i: f"72:4354:{i},{RPM[i]},{i / 9}"))


def test_rows_of_whole_seconds_are_spread_over_them(proposed: Proposed) -> None:
    text = "Time,RPM,AFR\n" + rows(lambda i: f"00:00:{i // 10:02d},{RPM[i]},{AFR[i]}")
    table, _ = proposed(text)
    np.testing.assert_allclose(np.diff(table.t_ns), 1e8, atol=1)
    assert any("36 rows with the time of another one" in line for line in table.notes.lines)


@pytest.mark.parametrize(
    ("column", "form"),
    [
        ("Millis", lambda i: f"{5000 + 100 * i}"),
        ("timestamp_us", lambda i: f"{5000000 + 100000 * i}"),
        ("time_h", lambda i: f"{12 + i / 36000:.8f}"),
        ("Time", lambda i: f"{73421 + i / 10:.1f}"),  # seconds of a day
        ("SECONDS", lambda i: f"{(86399 + i / 10) % 86400:.1f}"),  # over midnight
        ("Ticks", lambda i: f"{638999999990000000 + 1000000 * i}"),
        ("Clock", lambda i: f"{1770000000000 + 100 * i}"),
        ("", lambda i: f"{1770000000000000000 + 100000000 * i}"),  # an index
        ("Date", lambda i: f"{46353.5 + i / 864000:.9f}"),
        ("Time", lambda i: f"15:59:5{i // 10}:{i % 10}00"),
        ("Time (x0.1s)", str),
        ("Time (1/100 s)", lambda i: f"{10 * i}"),
        ("micros", lambda i: f"{2000000000 + 100000 * i}"),
        ("Time (ms)", lambda i: f"{(64000 + 100 * i) % 65536}"),  # of 16 bits
        ("Time_us", lambda i: f"{(4294000000 + 100000 * i) % 2**32}"),
        ("datenum", lambda i: f"{740050.5 + i / 864000:.9f}"),  # days since the year 0
        ("Time (days)", lambda i: f"{i / 864000:.9f}"),
        ("Temps (min)", lambda i: f"{i / 600:.6f}"),
        ("Time", lambda i: f"2026-12-01 10:00:0{i / 10:.1f} UTC"),
        ("Time", lambda i: f"20261201_10000{i / 10:.1f}"),
        ("Time", lambda i: f"12:59:5{i / 10:.1f} p. m."),
        ("time", lambda i: f"{95958 + i / 10 + 4040 * (i >= 20):09.2f}"),  # of day, as hhmmss
    ],
)
def test_the_steps_of_times_tell_their_unit(
    proposed: Proposed, column: str, form: Callable[[int], str]
) -> None:
    text = f"{column},RPM,AFR\n" + rows(lambda i: f"{form(i)},{RPM[i]},{AFR[i]}")
    table, _ = proposed(text)
    np.testing.assert_allclose(np.diff(table.t_ns), 1e8, atol=2e5)


def test_a_file_of_sections_is_read_whatever_its_suffix(tmp_path: Path) -> None:
    text = (
        "File created on 05/05/2026\n\n[header]\ntime\nlatitude\n\n[channel units]\nrpm\n\n"
        "[column names]\nsats time lat RPM Lambda_1\n\n[data]\n"
        + rows(lambda i: f"009 {235958 + i / 10 - 235960 * (i >= 20):09.2f} +03112.5 {RPM[i]} 1.0")
    )
    for suffix in (".vbo", ".txt", ".ascii"):
        path, profile = tmp_path / f"drive{suffix}", tmp_path / "drive.toml"
        path.write_text(text)
        assert cli.main(["check", str(path), "--write-profile", str(profile), "--force"]) == 0
        table = read_table(path, profile)
        np.testing.assert_allclose(np.diff(table.t_ns), 1e8, atol=2e5)
        assert values(table, "engine_speed_rpm").tolist() == RPM


def test_a_long_table_may_hold_one_signal_after_another(proposed: Proposed, tmp_path: Path) -> None:
    table, _ = proposed(
        "t,field,value\n"
        + "".join(f"{i / 1250},RPM,{1500 + i % 9}\n" for i in range(5000))
        + rows(lambda i: f"{i / 10},AFR,{AFR[i]}")
    )
    assert 3.9e9 <= table.t_ns[-1] - table.t_ns[0] < 4.1e9  # and not twice as long
    np.testing.assert_allclose(values(table, "lambda_measured")[-1], AFR[-1] / 14.7)
    # AND values of one time are one row, whether they stand side by side or not
    speeds = [f"{i / 10},RPM,{RPM[i]}\n" for i in ROWS]
    lambdas = [f"{i / 10},AFR,{AFR[i]}\n" for i in ROWS]
    path, profile = tmp_path / "drive.csv", tmp_path / "drive.toml"
    for lines in (speeds + lambdas, sorted(speeds + lambdas)):
        path.write_text("t,field,value\n" + "".join(lines))
        table = read_table(path, profile)
        np.testing.assert_allclose(table.t_ns, [1e8 * i for i in ROWS])
        assert values(table, "engine_speed_rpm").tolist() == RPM
    # AND a column of words is not both the name and the value, nor is any state a value
    for names in "Zeit, Messwert, Drehzahl", "Time, Sensor, State":
        path.write_text(f"{names}\n" + rows(lambda i: f"{i},{'aus'[: 2 + i % 2]},{i}"))
        with pytest.raises(RecordingError, match=rf"its columns \({names}\)"):
            read_table(path)
    # AND a signal keeps its unit
    path.write_text("t,pid,value,unit\n" + rows(lambda i: f"{i},Speed,{i},{'mph'[: 3 * i]}"))
    with pytest.raises(RecordingError, match="line 3: Speed in 'mph', before in ''"):
        read_table(path)


@pytest.mark.parametrize(
    ("header", "row", "other"),
    [
        ("Time,Vehicle,RPM,AFR", "{},A,{},14.7", "{},B,{},14.7"),
        ("Time,device_id,RPM,AFR", "{},1,{},14.7", "{},2,{},14.7"),
        ("host,time,name,value", "A,{},RPM,{}", "B,{},RPM,{}"),
        ("Time,RPM,AFR,VIN", "{},{},14.7,A", "{},{},14.7,B"),
    ],
)
def test_two_vehicles_in_one_table_are_refused(
    tmp_path: Path, header: str, row: str, other: str
) -> None:
    path, own = tmp_path / "two.csv", tmp_path / "own.toml"
    own.write_text('time = "Time"\n[signals]\nengine_speed_rpm = "RPM"\n')
    mixed = rows(lambda i: (row, other)[i % 2].format(i / 10, RPM[i]))
    path.write_text(f"{header}\n{mixed}")
    with pytest.raises(RecordingError, match=r"line [34]: \w+ of '\w', before of '\w'"):
        read_table(path, own)
    # AND the rows of one, and those of two devices that write or change their own columns, are read
    path.write_text(f"{header}\n" + rows(lambda i: row.format(i / 10, RPM[i])))
    assert values(read_table(path, own), "engine_speed_rpm").tolist() == RPM
    path.write_text("Time,Device,RPM,Lat\n" + rows(lambda i: f"{i},obd,{RPM[i]},\n{i}.5,gps,,48"))
    assert 40 <= len(read_table(path, own).t_ns) <= 80
    held = rows(lambda i: f"{i},obd,{RPM[i]},{48 + i}\n{i}.5,gps,{RPM[i]},{49 + i}")
    path.write_text(f"Time,Device,RPM,Lat\n{held}")
    assert 40 <= len(read_table(path, own).t_ns) <= 80


def test_one_broken_row_costs_a_note_and_many_the_table(proposed: Proposed, tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    good = [f"{i / 10},{1500 + i},{14.0 + i / 99:.2f}\n" for i in range(99)]
    # a quote without an end costs its row alone, below a header with a cell of two lines as well
    for header, broken in (('Time,RPM,"AFR\nleft"\n', '5.0,"16\n'), ("Time,RPM,AFR\n", "5.0,15\n")):
        table, _ = proposed(header + "".join([*good[:50], broken, *good[51:]]))
        assert len(table.t_ns) == 98
        line = header.count("\n") + 51
        assert f"1 row left out, the first: line {line}: 2 cells" in "".join(table.notes.lines)
    path.write_text("Time,RPM,AFR\n" + "".join([*good[:50], *["5.0,15\n"] * 4, *good[51:]]))
    with pytest.raises(RecordingError, match="line 52: 2 cells, the header has 3 columns"):
        read_table(path, path.with_suffix(".toml"))


def test_a_profile_names_the_columns_of_a_table_with_one_value_a_row(tmp_path: Path) -> None:
    # GIVEN a table whose columns have unusual names, and a profile that names them
    path, profile = tmp_path / "long.csv", tmp_path / "long.toml"
    path.write_text(
        "zeit,was,messwert,einh\n"
        + rows(lambda i: f"{i / 10},Drehzahl,{RPM[i]},rpm\n{i / 10 + 0.02},Sonde,{AFR[i]},AFR")
    )
    tree = (
        'time = ["zeit"]\n[signals]\nengine_speed_rpm = "Drehzahl"\nlambda_measured = "Sonde"\n'
        'fuel_cut = { column = "Sonde", above = 20.0 }\n'
        '[pivot]\nname = "was"\nvalue = "messwert"\n'
    )
    profile.write_text(tree + 'unit = "einh"\n')
    # WHEN it is read THEN each name is a column, with the unit beside it
    table = read_table(path, profile)
    np.testing.assert_allclose(np.unique(values(table, "engine_speed_rpm")), RPM)
    np.testing.assert_allclose(np.unique(values(table, "lambda_measured")), np.array(AFR) / 14.7)
    assert not values(table, "fuel_cut").any()
    # AND columns that are not there are named, and so is a key that is missing
    refused = {'"wert"': "wants the columns was with texts and wert", '""': "names no"}
    for name, wanted in refused.items():
        profile.write_text(tree.replace('"messwert"', name))
        with pytest.raises(O2Error, match=wanted):
            read_table(path, profile)


@pytest.mark.parametrize(
    ("column", "cell", "name", "wanted"),
    [
        ("MAP (psig)", -8.0, "manifold_pressure_kpa", 46.17),  # a gauge counts from the air
        ("MAP (barg)", -0.5, "manifold_pressure_kpa", 51.3),
        ("MAP [bar absolute]", 0.6, "manifold_pressure_kpa", 60.0),
        ("MAP {inHg Abs}", 20.0, "manifold_pressure_kpa", 67.73),
        ("MAP_kPa", 60.0, "manifold_pressure_kpa", 60.0),
        ("Coolant (℉)", 190.0, "coolant_temperature_degc", 87.78),
        ("nmot_w\\XETK:1 (1/min)", 1500.0, "engine_speed_rpm", 1500.0),
        ("AFR (E85)", 9.8, "lambda_measured", 1.0),
        ("Stoich AFR (AFR)", 14.7, "lambda_measured", None),
        ("Power Enrich (AFR)", 14.7, "lambda_measured", None),
        ("Predicted (AFR)", 14.7, "lambda_measured", None),
        ("MTX-L (AFR)", 14.7, "lambda_measured", 1.0),
        ("MAP (inHg vac)", 10.0, "manifold_pressure_kpa", None),  # below the air's pressure
        ("RPM (x1000)", 2.0, "engine_speed_rpm", None),
        ("MAP", 8.0, "manifold_pressure_kpa", None),  # psi or inHg?
        ("TPS", 0.2, "throttle_percent", 20.0),
        ("TPS raw", 20.0, "throttle_percent", None),
        ("KÃ¼hlmitteltemperatur (Â°C)", 88.0, "coolant_temperature_degc", 88.0),
        ("Coolant Temp (C°)", 88.0, "coolant_temperature_degc", 88.0),
        ("MAP", 3000.0, "manifold_pressure_kpa", None),
        ("Lambda (-*1000)", 1000.0, "lambda_measured", None),
        ("Phi", 0.98, "lambda_measured", None),
        ("Lambda Pre Cat", 1.0, "lambda_measured", 1.0),
        ("LAMB_LS_UP[1]", 1.0, "lambda_measured", 1.0),
        ("LAMB_LS_UP[2]", 1.0, "lambda_measured", None),  # a number in brackets is no unit
        ("Sonda Geral", 1.0, "lambda_measured", 1.0),
        ("Presión colector", 60.0, "manifold_pressure_kpa", 60.0),
        ("IAT", 77.0, "manifold_temperature_degc", 25.0),  # °F
        ("Temp. do motor", 190.0, "coolant_temperature_degc", 87.78),
        ("Coolant", 88.0, "coolant_temperature_degc", 88.0),
        ("Température eau", 88.0, "coolant_temperature_degc", 88.0),
        ("Coolant", 0.0, "coolant_temperature_degc", None),
        ("MAP", 190.0, "manifold_pressure_kpa", 190.0),  # a pull
        ("MAP", 230.0, "manifold_pressure_kpa", None),  # kPa or hPa?
        ("MAP", 500.0, "manifold_pressure_kpa", 50.0),
        ("Engine Load", 30.0, "load_g_per_rev", None),  # in percent
        ("Engine Load", 1.2, "load_g_per_rev", 1.2),
        ("Mass Air Flow", 20.0, "maf_kg_h", None),  # kg/h or g/s?
        ("AFR (AFR)", 9.8, "lambda_measured", None),  # as of E85
        ("mass_air_flow_kg_s", 0.005, "maf_kg_h", 18.0),
        ("AFM (g/s)", 5.0, "maf_kg_h", 18.0),
        ("HPFP (bar)", 60.0, "rail_pressure_mpa", 6.0),
        ("CL Lambda Trim (%)", -2.0, "lambda_controller", 0.98),
        ("MAP [kPa(g)]", -40.0, "manifold_pressure_kpa", 61.3),
        ("MAP", 25.0, "manifold_pressure_kpa", None),  # inHg, or kPa of an overrun?
        ('"Drosselklappe, %"', 20.0, "throttle_percent", 20.0),
        ("Mass Air Flow (lb/min) SAE.MAF", 1.0, "maf_kg_h", 27.22),  # words of one quantity
        ("Lambda Fuel Corr (%)", -2.0, "lambda_controller", 0.98),
        ("Motordrehzahl (rpm)", 1500.0, "engine_speed_rpm", 1500.0),  # no electric motor
        ("Частота вращения (об/мин)", 1500.0, "engine_speed_rpm", 1500.0),
        ("MAP (bar)", 2.6, "manifold_pressure_kpa", 260.0),  # a pull
        ("Injector Pulse Width Avg. Bank 1 (ms)", 4.0, "injector_pulse_width_ms", 4.0),
        ("IPW_ms", 4.0, "injector_pulse_width_ms", 4.0),
        ("Gaskleppositie (%)", 20.0, "throttle_percent", 20.0),
        ("Lambda sp. value (AFR)", 14.7, "lambda_measured", None),
    ],
)
def test_the_unit_with_words_beside_it_or_the_values_tell_what_a_column_is_or_it_is_none(
    proposed: Proposed, column: str, cell: float, name: str, wanted: float | None
) -> None:
    table, columns = proposed(
        f"Time (s),Vehicle Speed (km/h),{column}\n"
        + rows(lambda i: f"{i / 10},{10 + i},{cell * (1 + i / 4000):.6g}")
    )
    assert (name in columns) == (wanted is not None)
    if wanted:
        assert values(table, name)[0] == pytest.approx(wanted, rel=0.002)


def test_a_table_with_its_newest_row_first_is_read_from_its_end(tmp_path: Path) -> None:
    path = tmp_path / "newest.csv"
    lines = rows(lambda i: f"{i / 10},{RPM[i]},{AFR[i]}").splitlines()
    path.write_text("#1/2/2026,,\nTime (s),RPM,AFR\n" + "\n".join(lines[::-1]) + "\n")
    path.with_suffix(".toml").write_text('time = ["Time"]\n[signals]\nengine_speed_rpm = "RPM"\n')
    table = read_table(path, path.with_suffix(".toml"))
    assert values(table, "engine_speed_rpm").tolist() == RPM
    # AND one row alone is no recording
    path.write_text("Time (s),RPM,AFR\n" + lines[0] + "\n")
    with pytest.raises(RecordingError, match="1 row with a time, two are wanted"):
        read_table(path, path.with_suffix(".toml"))


def test_a_packed_table_that_is_cut_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path, profile = tmp_path / "cut.csv.gz", tmp_path / "cut.toml"
    text = "Time,RPM,AFR\n" + "".join(f"{i / 10},{1500 + i * i % 977},14.{i}\n" for i in range(999))
    path.write_bytes(gzip.compress(text.encode())[:-200])
    assert cli.main(["check", str(path), "--write-profile", str(profile)]) == 0
    table = read_table(path, profile)
    assert 500 < len(table.t_ns) < 999
    assert any("cut short after line" in line for line in table.notes.lines)


def test_numbers_may_stand_with_their_units_in_the_cells(
    proposed: Proposed, tmp_path: Path
) -> None:
    # GIVEN cells such as 14.7 AFR, one of another unit, -1 where the logger knows none, mV and V
    text = (
        "Time,Engine Speed,Air Fuel Ratio,Battery\n0 s,1500 rpm,0.98 lambda,\n"
        + "0.1 s,1500 rpm,-1 AFR,12.5 V\n"
        + rows(lambda i: f"{(i + 2) / 10} s,{RPM[i]} rpm,{AFR[i]:.2f} AFR,{12500 + i} mV")
    )
    table, _ = proposed(text)
    np.testing.assert_allclose(values(table, "battery_voltage_v")[:2], 12.5)
    np.testing.assert_allclose(values(table, "lambda_measured"), np.round(AFR, 2) / 14.7)
    assert values(table, "engine_speed_rpm").tolist() == [1500, 1500, *RPM]
    assert "1 unreadable cell left out, the first: line 2: column Air" in table.notes.lines[0]
    # AND a column that goes on in another unit is named: no sensor has fallen silent there
    path = tmp_path / "drive.csv"
    path.write_text(text + "4.2 s,3000 rpm,0.98 lambda,12.5 V\n")
    with pytest.raises(RecordingError, match=r"Air Fuel Ratio is '0.98 lambda', a number in"):
        read_table(path, path.with_suffix(".toml"))


def test_a_clock_in_counts_without_a_unit_is_asked_for(tmp_path: Path) -> None:
    path, own = tmp_path / "counts.csv", tmp_path / "own.toml"  # 20 ms a count, 5 a row
    path.write_text("Stamp,RPM,AFR\n" + rows(lambda i: f"{900 + 5 * i},{RPM[i]},{AFR[i]}"))
    own.write_text('time = "Stamp"\n[signals]\nengine_speed_rpm = "RPM"\n')
    with pytest.raises(RecordingError, match=r"Stamp have no unit and go up by 5: .* factor"):
        read_table(path, own)
    # AND so is one in days, in the digits of a date, in what nobody knows, or of one row in minutes
    for name, first, step in (
        ("Stamp", 0.0, 1e-6),
        ("Stamp", 20261128063000.0, 1.0),
        ("Stamp (ticks)", 0.0, 1.0),
        ("Stamp", 1.77e9, 300.0),
    ):
        cells = [f"{first + step * i:.6f},{RPM[i]}\n" for i in ROWS]
        path.write_text(f"{name},RPM\n" + "".join(cells))
        with pytest.raises(RecordingError, match="have no unit and go up by"):
            read_table(path, own)
    path.write_text("Stamp,RPM,AFR\n" + rows(lambda i: f"{900 + 5 * i},{RPM[i]},{AFR[i]}"))
    own.write_text(own.read_text().replace('"Stamp"', '{ column = "Stamp", factor = 0.02 }', 1))
    np.testing.assert_allclose(np.diff(read_table(path, own).t_ns), 1e8)


@pytest.mark.parametrize(("coolant", "intake"), [(87.0, 70.0), (189.0, 104.0)])
@pytest.mark.parametrize("names", ["Coolant_Temperature,Intake_Air_Temp", "CLT,IAT"])
def test_temperatures_without_a_unit_have_one_setting(
    proposed: Proposed, names: str, coolant: float, intake: float
) -> None:
    table, _ = proposed(
        f"Time (s),RPM,{names}\n"
        + rows(lambda i: f"{i / 10},{RPM[i]},{coolant + 0.01 * i},{intake + 0.01 * i}")
    )
    said = [values(table, f"{n}_temperature_degc")[0] for n in ("coolant", "manifold")]
    celsius = [(each - 32.0) / 1.8 if coolant > 150.0 else each for each in (coolant, intake)]
    assert said == pytest.approx(celsius)


@pytest.mark.parametrize(
    ("names", "pressure"),
    [
        ("GPS Time,Device Time,Engine RPM(rpm),Speed (OBD),Engine Coolant Temperature,"
         "Intake Manifold Pressure", 6.894757),
        ("Clock,Time,Engine RPM,Vehicle speed,Engine coolant temperature,"
         "Intake manifold absolute pressure,Absolute throttle position", 3.386389),
    ],
)  # fmt: skip
def test_a_logger_set_to_other_units_is_read_in_them_though_its_names_state_none(
    tmp_path: Path, names: str, pressure: float
) -> None:
    # GIVEN a drive at 87 °C, 60 kPa and 80 km/h, in °F, psi or inHg, and mph, without their names
    path = tmp_path / "drive.csv"
    cells = f"188.6,{60 / pressure:.4f}"
    path.write_text(
        names + "\n" + rows(lambda i: f"x,10:00:0{i / 10},{RPM[i]},{49 + i / 50},{cells},20")
    )
    # WHEN its shipped profile reads it THEN the coolant, which can be in °F only, tells all
    table = read_table(path)
    assert table.profile in ("torque", "obdlink")
    assert values(table, "coolant_temperature_degc")[0] == pytest.approx(87.0)
    assert values(table, "manifold_pressure_kpa")[0] == pytest.approx(60.0, rel=1e-3)
    assert values(table, "vehicle_speed_km_h")[0] == pytest.approx(49 * 1.609344)


def test_a_reading_that_is_half_below_any_mixture_is_no_lambda(proposed: Proposed) -> None:
    # GIVEN the volts of a narrowband sensor without their unit
    volts = rows(lambda i: f"{i / 10},{RPM[i]},{(0.2, 0.6, 0.8)[i % 3] + i / 1000}")
    _, columns = proposed("Time,RPM,Lambda sensor\n" + volts)
    assert "lambda_measured" not in columns
