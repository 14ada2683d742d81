"""``o2mon map``: signal maps proposed from databases."""

import doctest
import logging
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from cantools.database import load_string
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import dbc
from monitor.bus_map import load_database, load_pairs
from monitor.cli import main
from monitor.errors import SignalMapError
from monitor.mapping import toml_text, units, words
from monitor.mapping.make import make_map
from monitor.mapping.observe import observe, reranked
from monitor.mapping.propose import FUEL_FLOW_NAME, Proposals, propose, ranked
from monitor.mapping.protection import borne_out, protection
from monitor.mapping.text import map_text
from monitor.signal_map import load_signal_map
from monitor.signals import BY_NAME
from monitor.types import Frame

ROOT = Path(__file__).resolve().parent.parent
logging.getLogger("cantools").setLevel(logging.ERROR)  # made-up databases repeat names
OWN = ["o2_ecu", "rusefi", "obd2"]


def database_of(
    *signals: str, message: str = "Engine_1", length: int = 64, more: str = ""
) -> Database:
    """Return a database with one message; signals as ``Name (factor,offset) [min|max] "unit"``."""
    lines = []
    for n, text in enumerate(signals):
        name, rest = text.split(" ", 1)
        lines.append(f" SG_ {name} : {16 * n}|16@1+ {rest} X")
    body = "\n".join(lines)
    return load_string(
        f'VERSION ""\nBU_: ECU X\nBO_ 256 {message}: {length} ECU\n{body}\n{more}\n', strict=False
    )


def proposed(database: Database, **options: Any) -> tuple[str, Proposals]:
    return make_map(database, Path("test.dbc"), **options)


def found(database: Database) -> dict[str, tuple[str, float, float]]:
    """Return signal, factor and offset by canonical name."""
    _, proposals = proposed(database)
    return {c.name: (c.signal.name, c.factor, c.offset) for c in proposals.found}


@pytest.mark.parametrize("name", OWN)
def test_the_shipped_maps_are_found_again(name: str, tmp_path: Path) -> None:
    path = dbc.path(f"{name}.dbc")
    text, proposals = proposed(load_database(path))
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    mine, shipped = (
        load_pairs([(path, tmp_path / "m.toml")]),
        load_signal_map(dbc.path(f"{name}.toml")),
    )
    assert set(mine.names) == shipped.signals.keys() | shipped.derived.keys()
    for canonical, wanted in shipped.signals.items():
        got = mine.channels[canonical].mapped
        assert (got.message, got.signal) == (wanted.message, wanted.signal)
        assert got.factor == pytest.approx(wanted.factor, rel=1e-9)
        assert got.offset == pytest.approx(wanted.offset, rel=1e-9)
    for canonical, recipe in shipped.derived.items():
        own = mine.derived[canonical]
        sources = (own.numerator, own.denominator), (recipe.numerator, recipe.denominator)
        assert [len(x) for x in sources[0]] == [len(x) for x in sources[1]]
    assert len(proposals.names) == len(mine.names)


def test_fuel_from_a_flow_is_worth_the_same_as_in_the_shipped_map(tmp_path: Path) -> None:
    for name in ("rusefi", "obd2"):
        path = dbc.path(f"{name}.dbc")
        text, _ = proposed(load_database(path))
        (tmp_path / "m.toml").write_text(text, encoding="utf-8")
        mine = load_pairs([(path, tmp_path / "m.toml")])
        shipped = load_pairs([(path, dbc.path(f"{name}.toml"))])
        (source,) = (s for s in shipped.derived["fuel_mass_mg"].numerator)
        a = mine.channels[FUEL_FLOW_NAME].mapped.factor * mine.derived["fuel_mass_mg"].factor
        b = shipped.channels[source].mapped.factor * shipped.derived["fuel_mass_mg"].factor
        assert a == pytest.approx(b, rel=1e-9)


def test_two_wideband_controllers_are_a_choice_for_a_person() -> None:
    text, proposals = proposed(load_database(dbc.path("wideband.dbc")))
    assert proposals.names == ()
    for name in ("wideband", "aem_x"):
        for canonical, wanted in load_signal_map(dbc.path(f"{name}.toml")).signals.items():
            line = f'#   {canonical} = {{ message = "{wanted.message}", signal = "{wanted.signal}"'
            assert line in text
    assert "AMBIGUOUS" in text


GERMAN = (
    'MO_Motordrehzahl (0.25,0) [0|16383] "U/min"',
    'MO_Kuehlmitteltemperatur (0.75,-48) [-48|143] "Unit_Foo"',
    'MO_Saugrohrdruck (0.5,0) [0|3500] "hPa"',
    'MO_Ansauglufttemperatur (0.75,-48) [-48|143] "°C"',
    'MO_Luftmassenstrom (0.1,0) [0|1000] "kg/h"',
    'MO_Raildruck (0.1,0) [0|300] "bar"',
    'MO_Lambda_Istwert (0.0005,0) [0|16] "-"',
    'MO_Lambda_Sollwert (0.0005,0) [0|16] "-"',
    'MO_Lambdaregler (0.001,0) [0|2] "-"',
    'MO_Einspritzmenge (0.01,0) [0|200] "mg/Hub"',
    'ESP_Fahrgeschwindigkeit (0.01,0) [0|300] "km/h"',
    'MO_Drosselklappe (0.01,0) [0|100] "%"',
    'MO_Aussentemperatur (0.5,-50) [-50|77] "°C"',
    'MO_Umgebungsdruck (1,0) [500|1200] "mbar"',
    'MO_Batteriespannung (0.01,0) [0|20] "V"',
    'MO_Motormoment (0.1,-500) [-500|1000] "Nm"',
)
ABBREVIATED = (
    'EngSpd (0.25,0) [0|8000] "rpm"',
    'ECT (1,-40) [-40|300] "degF"',
    'MAP_abs (0.01,0) [0|300] "kPa"',
    'IAT (1,-40) [-40|300] "°F"',
    'MAF (0.01,0) [0|655] "g/s"',
    'FRP (0.1,0) [0|3000] "psi"',
    'AFR (0.001,0) [7|25] ""',
    'STFT_B1 (0.1,-100) [-100|100] "%"',
    'VehSpd (0.1,0) [0|200] "mph"',
    'TPS (0.1,0) [0|100] "%"',
    'BaroPress (0.01,0) [0|2] "bar"',
    'VBatt (1,0) [0|20000] "mV"',
    'FuelInjMass (0.01,0) [0|200] "mg"',
)


def test_a_database_in_german_is_understood() -> None:
    # GIVEN names as German carmakers write them
    # WHEN a map is proposed
    got = found(database_of(*GERMAN))
    # THEN every signal is found and brought to its unit; the unit nobody knows stays in doubt
    assert got.pop("coolant_temperature_degc", None) is None
    assert got == {
        "engine_speed_rpm": ("MO_Motordrehzahl", 1.0, 0.0),
        "manifold_pressure_kpa": ("MO_Saugrohrdruck", pytest.approx(0.1), 0.0),
        "manifold_temperature_degc": ("MO_Ansauglufttemperatur", 1.0, 0.0),
        "maf_kg_h": ("MO_Luftmassenstrom", 1.0, 0.0),
        "rail_pressure_mpa": ("MO_Raildruck", pytest.approx(0.1), 0.0),
        "lambda_measured": ("MO_Lambda_Istwert", 1.0, 0.0),
        "lambda_target": ("MO_Lambda_Sollwert", 1.0, 0.0),
        "lambda_controller": ("MO_Lambdaregler", 1.0, 0.0),
        "fuel_mass_mg": ("MO_Einspritzmenge", 1.0, 0.0),
        "vehicle_speed_km_h": ("ESP_Fahrgeschwindigkeit", 1.0, 0.0),
        "throttle_percent": ("MO_Drosselklappe", 1.0, 0.0),
        "ambient_temperature_degc": ("MO_Aussentemperatur", 1.0, 0.0),
        "ambient_pressure_kpa": ("MO_Umgebungsdruck", pytest.approx(0.1), 0.0),
        "battery_voltage_v": ("MO_Batteriespannung", 1.0, 0.0),
        "engine_torque_nm": ("MO_Motormoment", 1.0, 0.0),
    }


def test_abbreviations_and_imperial_units_are_understood() -> None:
    got = found(database_of(*ABBREVIATED))
    assert got == {
        "engine_speed_rpm": ("EngSpd", 1.0, 0.0),
        "coolant_temperature_degc": ("ECT", pytest.approx(5 / 9), pytest.approx(-160 / 9)),
        "manifold_pressure_kpa": ("MAP_abs", 1.0, 0.0),
        "manifold_temperature_degc": ("IAT", pytest.approx(5 / 9), pytest.approx(-160 / 9)),
        "maf_kg_h": ("MAF", pytest.approx(3.6), 0.0),
        "rail_pressure_mpa": ("FRP", pytest.approx(0.006894757), 0.0),
        "lambda_measured": ("AFR", pytest.approx(1 / 14.7), 0.0),
        "lambda_controller": ("STFT_B1", pytest.approx(0.01), 1.0),
        "vehicle_speed_km_h": ("VehSpd", pytest.approx(1.609344), 0.0),
        "throttle_percent": ("TPS", 1.0, 0.0),
        "ambient_pressure_kpa": ("BaroPress", pytest.approx(100.0), 0.0),
        "battery_voltage_v": ("VBatt", pytest.approx(0.001), 0.0),
        "fuel_mass_mg": ("FuelInjMass", 1.0, 0.0),
    }


def test_bosch_labels_are_understood() -> None:
    got = found(
        database_of(
            'nmot_w (0.25,0) [0|16000] "1/min"',
            'lamsoni_w (0.000244,0) [0|16] "-"',
            'lamsons_w (0.000244,0) [0|16] "-"',
            'fr_w (0.00003,0) [0|2] "-"',
            'tmot (0.75,-48) [-48|143] "Grad C"',
            'tans (0.75,-48) [-48|143] "Grad C"',
            'ps_w (0.04,0) [0|2500] "hPa"',
            'ml_w (0.1,0) [0|6500] "kg/h"',
            'prist_w (0.005,0) [0|300] "bar"',
            'vfzg_w (0.008,0) [0|500] "km/h"',
            'ub (0.1,0) [0|25] "V"',
            'wdkba (0.4,0) [0|100] "%"',
        )
    )
    assert {name: place for name, (place, _, _) in got.items()} == {
        "engine_speed_rpm": "nmot_w",
        "lambda_measured": "lamsoni_w",
        "lambda_target": "lamsons_w",
        "lambda_controller": "fr_w",
        "coolant_temperature_degc": "tmot",
        "manifold_temperature_degc": "tans",
        "manifold_pressure_kpa": "ps_w",
        "maf_kg_h": "ml_w",
        "rail_pressure_mpa": "prist_w",
        "vehicle_speed_km_h": "vfzg_w",
        "battery_voltage_v": "ub",
        "throttle_percent": "wdkba",
    }


def test_names_as_in_j1939_are_understood() -> None:
    got = found(
        database_of(
            'EngSpeed (0.125,0) [0|8031] "rpm"',
            'EngCoolantTemp (1,-40) [-40|210] "°C"',
            'EngIntakeManifold1Press (2,0) [0|500] "kPa"',
            'EngIntakeManifold1Temp (1,-40) [-40|210] "°C"',
            'AmbientAirTemp (0.03125,-273) [-273|1735] "°C"',
            'BarometricPress (0.5,0) [0|125] "kPa"',
            'WheelBasedVehicleSpeed (0.00390625,0) [0|250] "km/h"',
            'EngInletAirMassFlowRate (0.05,0) [0|3212] "kg/h"',
            'EngOilTemp1 (1,-40) [-40|210] "°C"',
            'EngInjectorMeteringRail1Press (0.00390625,0) [0|250] "MPa"',
        )
    )
    assert {name: place for name, (place, _, _) in got.items()} == {
        "engine_speed_rpm": "EngSpeed",
        "coolant_temperature_degc": "EngCoolantTemp",
        "manifold_pressure_kpa": "EngIntakeManifold1Press",
        "manifold_temperature_degc": "EngIntakeManifold1Temp",
        "ambient_temperature_degc": "AmbientAirTemp",
        "ambient_pressure_kpa": "BarometricPress",
        "vehicle_speed_km_h": "WheelBasedVehicleSpeed",
        "maf_kg_h": "EngInletAirMassFlowRate",
        "rail_pressure_mpa": "EngInjectorMeteringRail1Press",
    }


def test_an_equivalence_ratio_becomes_lambda_by_derivation(tmp_path: Path) -> None:
    database = database_of('EquivalenceRatio (0.0001,0) [0|2] "phi"')
    text, proposals = proposed(database)
    assert proposals.names == ("lambda_measured",)
    (tmp_path / "m.toml").write_text(text)
    recipe = load_signal_map(tmp_path / "m.toml").derived["lambda_measured"]
    assert (recipe.numerator, recipe.denominator) == ((), ("phi_measured",))


def test_air_per_stroke_follows_from_flow_and_speed_with_the_cylinders(tmp_path: Path) -> None:
    database = database_of('MAF (0.01,0) [0|655] "kg/h"', 'RPM (1,0) [0|8000] "rpm"')
    text, _ = proposed(database, cylinders=6)
    (tmp_path / "m.toml").write_text(text)
    # 60 kg/h at 2000 1/min: 1 kg/min over 2000 * 6 / 2 strokes a minute
    recipe = load_signal_map(tmp_path / "m.toml").derived["air_mass_mg"]
    assert recipe.factor * 60.0 / 2000.0 == pytest.approx(1e6 / 6000)


def lambda_signal(name: str) -> str:
    return f'{name} (0.0005,0) [0|16] ""'


@pytest.mark.parametrize(
    "name",
    ["Lambda_B1S2", "Lambda_B2S1", "Lambda2", "Lam2", "O2S12_Lambda", "HO2S21_Lambda",
     "O2_S2_Lambda", "LambdaBank2", "LambdaSensor2",
     "LambdaDownstream", "Lambda_post_cat", "LambdaPostCat",
     "LambdaNachKat", "LambdaHinterKat", "lamhk", "Lambda_hk", "Lambda_nk", "RearLambda",
     "LambdaRear", "LambdaBinary", "LambdaRight", "Lambda_links", "LambdaKat", "Lambda_sec",
     "LSF_Lambda",
     "Wideband2", "AFR_2", "lamsoni2_w", "LambdaSonde2"],
)  # fmt: skip
def test_another_sensor_is_never_taken_for_the_upstream_one(name: str) -> None:
    text, proposals = proposed(database_of(lambda_signal(name)))
    assert "lambda_measured" not in proposals.names
    assert not re.search(r"^lambda_measured", text, re.MULTILINE)
    with_first = found(database_of(lambda_signal(name), lambda_signal("LambdaB1S1")))
    assert with_first["lambda_measured"][0] == "LambdaB1S1"


@pytest.mark.parametrize("second", [
    "Bank2", "B2", "Sensor2", "S2", "2", "02", "B1S2", "B2S1", "Downstream", "PostCat", "Post",
    "Rear", "NachKat", "HinterKat", "Nk", "Hk", "Behind", "After", "Right", "Links", "Secondary",
    "Cat", "Kat", "Nernst", "Narrowband", "Ds",
])  # fmt: skip
@pytest.mark.parametrize(
    "sensor", ["Lambda", "Lam", "AFR", "Wideband", "Uego", "O2_Lambda", "Sonde_Lambda"]
)
def test_however_it_is_spelled(sensor: str, second: str) -> None:
    for parts in (
        (sensor, second),
        (second, sensor),
        (sensor, second, "Value"),
        ("EMS", sensor, second),
    ):
        for joint in ("_", ""):
            styles = (str, str.lower, str.upper) if joint else (str,)
            for style in styles:
                name = joint.join(style(part) for part in parts)
                if name[0].isdigit():
                    continue
                _, proposals = proposed(database_of(lambda_signal(name)))
                assert "lambda_measured" not in proposals.names, name


@pytest.mark.parametrize(
    "message", ["O2_Bank2", "PostCat_O2", "Lambda_Sensor_2", "Lambda_hinterKat"]
)
def test_nor_is_one_whose_message_says_so(message: str) -> None:
    _, proposals = proposed(database_of(lambda_signal("Lambda"), message=message))
    assert "lambda_measured" not in proposals.names


def test_nor_is_one_whose_comment_says_so() -> None:
    more = 'CM_ SG_ 256 Lambda "Wideband behind the catalyst";'
    _, proposals = proposed(database_of(lambda_signal("Lambda"), more=more))
    assert "lambda_measured" not in proposals.names


@pytest.mark.parametrize("other", ["LambdaAct", "LambdaMeas", "AFR_Lambda", "UegoLambda"])
def test_two_sensors_that_nothing_tells_apart_are_a_choice(other: str) -> None:
    text, proposals = proposed(database_of(lambda_signal("LambdaValue"), lambda_signal(other)))
    assert "lambda_measured" not in proposals.names
    assert "AMBIGUOUS" in text


def test_the_one_that_is_said_to_be_upstream_is_taken() -> None:
    got = found(database_of(lambda_signal("LambdaMeas"), lambda_signal("LambdaUpstream")))
    assert got["lambda_measured"][0] == "LambdaUpstream"


@pytest.mark.parametrize(
    ("signal", "canonical"),
    [
        ('EngineSpeedTarget (0.25,0) [0|8000] "rpm"', "engine_speed_rpm"),
        ('TurbineSpeed (0.25,0) [0|8000] "rpm"', "engine_speed_rpm"),
        ('OilTemp (1,-40) [-40|200] "degC"', "coolant_temperature_degc"),
        ('ExhaustManifoldPressure (1,0) [0|500] "kPa"', "manifold_pressure_kpa"),
        ('WheelSpeedFL (0.1,0) [0|300] "km/h"', "vehicle_speed_km_h"),
        ('LambdaHeaterDuty (0.1,0) [0|100] "%"', "lambda_controller"),
        ('LambdaVoltage (0.001,0) [0|5] "V"', "lambda_measured"),
        ('LambdaTarget (0.0005,0) [0|16] ""', "lambda_measured"),
        ('LongFuelTrim (0.1,-100) [-100|100] "%"', "lambda_controller"),
        ('FuelTrim2 (0.1,-100) [-100|100] "%"', "lambda_controller"),
        ('AcceleratorPedal (0.1,0) [0|100] "%"', "throttle_percent"),
        ('LowFuelPressure (0.1,0) [0|10] "bar"', "rail_pressure_mpa"),
        ('HybridBatteryVoltage (0.1,0) [0|500] "V"', "battery_voltage_v"),
        ('Lambda (1,0) [0|1] ""', "lambda_measured"),
        ('MAP (1,0) [0|100] "%"', "manifold_pressure_kpa"),
        ('MAP (0.1,-101.3) [0|0] "kPa"', "manifold_pressure_kpa"),
    ],
)
def test_what_only_resembles_is_not_proposed(signal: str, canonical: str) -> None:
    assert canonical not in found(database_of(signal))


def test_every_proposal_says_why_and_what_else_it_could_be() -> None:
    text, proposals = proposed(
        database_of('EngineSpeed (0.25,0) [0|8000] "rpm"', 'CrankSpeed (1,0) [0|8000] ""')
    )
    lines = text.splitlines()
    at = lines.index(next(line for line in lines if line.startswith("engine_speed_rpm")))
    assert re.match(r"# 1\.00: Engine_1\.EngineSpeed; its name says EngineSpeed; its unit is rpm",
                    lines[at - 1])  # fmt: skip
    assert lines[at + 1].startswith("#   or ")
    assert "CrankSpeed" in lines[at + 1]
    assert proposals.names == ("engine_speed_rpm",)


@pytest.mark.parametrize("module", [words, units, toml_text])
def test_its_examples_run(module: ModuleType) -> None:
    ran = doctest.testmod(module)
    assert ran.attempted
    assert not ran.failed


# a recording


def test_a_recording_bears_out_counters_checksums_and_signals() -> None:
    (log,) = ROOT.glob("replay_logs/healthy_micro*.blf")
    text, proposals = proposed(load_database(dbc.path("o2_ecu.dbc")), log=log)
    assert set(proposals.names) == BY_NAME.keys()
    assert text.count('algorithm = "crc8_sae_j1850_id"') == 7
    assert "\ncounter" in text
    assert "moves with manifold_pressure_kpa" in text


def test_a_recording_decides_between_two_controllers(tmp_path: Path) -> None:
    log = tmp_path / "wideband.log"
    lam = [round(1e4 * (1.0 + 0.02 * ((k % 20) - 10) / 10)) for k in range(400)]
    log.write_text(
        "".join(
            f"({k / 100:.6f}) can0 190#A001{x.to_bytes(2, 'little').hex().upper()}0C030000\n"
            for k, x in enumerate(lam)
        )
    )
    text, proposals = proposed(load_database(dbc.path("wideband.dbc")), log=log)
    assert proposals.names == ("lambda_measured", "sensor_ready")
    assert {c.message.name for c in proposals.found} == {"WidebandData"}
    assert "lacks its message" in text


def test_a_recording_finds_out_a_unit_that_is_wrong(tmp_path: Path) -> None:
    # GIVEN a pressure that the database gives in kPa, but that is sent in hPa
    database = database_of('MAP (1,0) [0|2500] "kPa"', length=8)
    log = tmp_path / "d.log"
    payloads = [(900 + k).to_bytes(8, "little").hex().upper() for k in range(60)]
    log.write_text("".join(f"({k / 10:.6f}) can0 100#{x}\n" for k, x in enumerate(payloads)))
    text, proposals = proposed(database, log=log)
    assert proposals.names == ()
    assert "implausible in the recording" in text


# the command


def test_the_command_writes_a_map_and_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rusefi.toml"
    assert main(["map", str(dbc.path("rusefi.dbc")), "--out", str(out)]) == 0
    assert load_signal_map(out).signals["engine_speed_rpm"].signal == "RPM"
    assert "o2mon check LOG" in capsys.readouterr().out
    assert main(["map", str(dbc.path("rusefi.dbc")), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["map", str(dbc.path("wideband.dbc"))]) == 3
    printed = capsys.readouterr()
    assert printed.out.startswith("# Signal map for wideband.dbc")
    assert "a model needs it" in printed.err


@pytest.mark.parametrize("name", ["missing.dbc", "bad.dbc"])
def test_a_database_that_cannot_be_read_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.dbc").write_text("BO_ nonsense")
    assert main(["map", str(tmp_path / name)]) == 2
    assert name in capsys.readouterr().err


# anything

VOCABULARY = (
    "Lambda O2 AFR B1S2 Bank2 Engine Motor Speed Drehzahl Temp Coolant Air Luft Mass Flow Fuel "
    "Rail Pressure Druck MAP TPS Trim Target Soll Valid _ 2 1 x w λ Ö Purge Closed Loop Cut CRC"
)
WORDS = st.sampled_from(VOCABULARY.split())
NAMES = st.one_of(
    st.lists(WORDS, min_size=1, max_size=5).map("".join),
    st.text(min_size=1, max_size=12),
)
UNITS = st.one_of(
    st.none(),
    st.sampled_from(["", "rpm", "°C", "%", "bar", "kg/h", "mg", "AFR", "lambda", "V", "???"]),
    st.text(max_size=6),
)
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False).filter(lambda x: abs(x) > 1e-6)


@st.composite
def signals(draw: st.DrawFn, index: int) -> Signal:
    low, high = draw(st.one_of(st.none(), NUMBERS)), draw(st.one_of(st.none(), NUMBERS))
    is_float = draw(st.booleans()) and draw(st.booleans())
    return Signal(
        name=draw(NAMES),
        start=(draw(st.integers(0, 3)) * 16),
        length=16 if is_float else draw(st.integers(1, 16)),
        byte_order="little_endian",
        is_signed=draw(st.booleans()),
        conversion=BaseConversion.factory(
            scale=draw(NUMBERS), offset=draw(st.floats(-1e3, 1e3)), is_float=is_float
        ),
        minimum=low,
        maximum=high,
        unit=draw(UNITS),
        comment=draw(st.one_of(st.none(), st.text(max_size=20))),
    )


@st.composite
def databases(draw: st.DrawFn) -> Database:
    messages = [
        Message(
            frame_id=draw(st.integers(0, 0x7FF)),
            name=draw(NAMES),
            length=8,
            signals=[draw(signals(k)) for k in range(draw(st.integers(0, 6)))],
            cycle_time=draw(st.one_of(st.none(), st.integers(0, 5000))),
            strict=False,
        )
        for _ in range(draw(st.integers(0, 4)))
    ]
    return Database(messages=messages, strict=False)


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(database=databases())
def test_no_database_upsets_it_and_what_it_writes_is_a_map(
    database: Database, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, proposals = proposed(database)
    path = tmp_path_factory.mktemp("map") / "m.toml"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    if proposals.names:
        loaded = load_signal_map(path)
        assert set(loaded.signals) | set(loaded.derived) == set(proposals.names)
        places = {(m.message, m.signal) for m in loaded.signals.values()}
        assert len(places) == len(loaded.signals)
        for mapped in loaded.signals.values():
            message = database.get_message_by_name(mapped.message)
            assert message.get_signal_by_name(mapped.signal)
    else:
        with pytest.raises(SignalMapError, match="is empty"):
            load_signal_map(path)
    assert map_text(proposals, Path("x.dbc"))


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(database=databases(), data=st.data())
def test_no_recording_upsets_it(
    database: Database, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    ids = sorted({message.frame_id for message in database.messages}) or [1]
    payloads = data.draw(st.lists(st.binary(min_size=0, max_size=8), min_size=1, max_size=30))
    frames = [
        Frame(k * 100_000_000, ids[k % len(ids)], False, payload)
        for k, payload in enumerate(payloads * 5)
    ]
    found = ranked(database)
    observed = observe(frames, found, Path("x.dbc"))
    proposals = propose(database, 4, reranked(found, observed))
    guarded = borne_out(protection(database.messages), observed.payloads)
    text = map_text(proposals, Path("x.dbc"), Path("x.log"), guarded)
    if proposals.names:
        path = tmp_path_factory.mktemp("map") / "m.toml"
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        assert set(load_signal_map(path).signals) <= set(proposals.names)
