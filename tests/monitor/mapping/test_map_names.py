"""What ``o2mon map`` understands: languages, abbreviations, units, and which sensor is meant."""

from pathlib import Path

import pytest
from cantools.database.can import Database

import dbc
from monitor.decode.bus_map import load_database
from monitor.decode.signal_map import load_signal_map
from tests.helpers.logs.databases import database_of, proposed


def found(database: Database) -> dict[str, tuple[str, float, float]]:
    """Return signal, factor and offset by canonical name."""
    _, proposals = proposed(database)
    return {c.name: (c.entry["signal"], c.fit.factor, c.fit.offset) for c in proposals.found}


def test_two_wideband_controllers_are_a_choice_for_a_person() -> None:
    text, proposals = proposed(load_database(dbc.path("wideband.dbc")))
    assert proposals.names == ("sensor_heater_percent",)  # one of them alone has it
    for name in ("wideband", "aem_x"):
        for canonical, wanted in load_signal_map(dbc.path(f"{name}.toml")).signals.items():
            line = f'#   {canonical} = {{ message = "{wanted.message}", signal = "{wanted.signal}"'
            assert line in text
    assert "AMBIGUOUS" in text


# canonical signal, what stands in the database, and the factor where it is not 1
LANGUAGES = [path.read_text("utf-8") for path in sorted(Path(__file__).parent.glob("languages/*"))]


@pytest.mark.parametrize("language", LANGUAGES)
def test_names_and_units_of_every_language_are_understood(language: str) -> None:
    # GIVEN a database with names as carmakers and suppliers write them
    signals, wanted = [], {}
    for line in language.strip().splitlines():
        canonical, signal = line.split(maxsplit=1)
        signal, _, conversion = signal.partition("=")
        factor, offset = [*map(float, conversion.split()), *(1.0, 0.0)[len(conversion.split()) :]]
        signals.append(signal.strip())
        wanted[canonical] = (signal.split()[0], pytest.approx(factor), pytest.approx(offset))
    # WHEN a map is proposed THEN every signal is found and brought to its unit; what nobody
    # knows stays in doubt
    wanted.pop("-", None)
    assert found(database_of(*signals)) == wanted


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


def test_a_word_that_says_something_is_no_ecu_s_abbreviation_before_a_name() -> None:
    corrections = (f'{what}_Fuel_Corr (0.1,0) [0|200] "%"' for what in ("Baro", "Purge"))
    names = found(database_of(*corrections, 'RPM (1,0) [0|8000] "rpm"'))
    assert names.keys() == {"engine_speed_rpm"}


@pytest.mark.parametrize(("message", "is_engine_s"), [("Status_1", False), ("Engine_1", True)])
def test_a_torque_of_the_engine_s_message_is_the_engine_s(message: str, is_engine_s: bool) -> None:
    signals = 'EstimatedTorque (0.5,-100) [-100|800] "Nm"', 'RPM (1,0) [0|8000] ""'
    assert ("engine_torque_nm" in found(database_of(*signals, message=message))) == is_engine_s


@pytest.mark.parametrize(("name", "is_turned"), [("FuelCutOff", False), ("Fuel_Cut_not", True)])
def test_a_fuel_cut_off_is_no_contrary_of_a_fuel_cut(name: str, is_turned: bool) -> None:
    text, _ = proposed(database_of(f'{name} (1,0) [0|1] ""', 'RPM (1,0) [0|8000] "rpm"'))
    line = next(line for line in text.splitlines() if "fuel_cut = {" in line)
    assert ("factor = -1.0" in line) == is_turned and name in line


def lambda_signal(name: str) -> str:
    return f'{name} (0.0005,0) [0|16] ""'


OTHER_SENSORS = """
    Lambda_B1S2 O2S12_Lambda HO2S21_Lambda O2_S2_Lambda Lambda_post_cat lamhk LambdaBinary
    Lambda_sec LSF_Lambda lamsoni2_w LambdaSonde2
"""


@pytest.mark.parametrize("name", OTHER_SENSORS.split())
def test_another_sensor_is_never_taken_for_the_upstream_one(name: str) -> None:
    assert "lambda_measured" not in found(database_of(lambda_signal(name)))
    with_first = found(database_of(lambda_signal(name), lambda_signal("LambdaB1S1")))
    assert with_first["lambda_measured"][0] == "LambdaB1S1"


SECOND = """
    Bank2 B2 Sensor2 S2 2 02 B1S2 B2S1 Downstream PostCat Post Rear NachKat HinterKat Nk Hk
    Behind After Right Links Secondary Cat Kat Nernst Narrowband Ds
"""


@pytest.mark.parametrize("second", SECOND.split())
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
    "said",
    [
        *({"message": each} for each in ("O2_Bank2", "PostCat_O2", "Lambda_Sensor_2")),
        {"message": "Lambda_hinterKat"},
        {"more": 'CM_ SG_ 256 Lambda "Wideband behind the catalyst";'},
    ],
)
def test_nor_is_one_whose_message_or_comment_says_so(said: dict[str, str]) -> None:
    _, proposals = proposed(database_of(lambda_signal("Lambda"), **said))
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
        ('L_TRIM (0.1,-100) [-100|100] "%"', "lambda_controller"),
        ('Lambda (1,0) [0|1] ""', "lambda_measured"),
        ('MAP (1,0) [0|100] "%"', "manifold_pressure_kpa"),
        ('MAP (0.1,-101.3) [0|0] "kPa"', "manifold_pressure_kpa"),
        ('MAP -(0.1,0) [-100|300] "kPa"', "manifold_pressure_kpa"),
        ('Wideband_B (0.001,0) [0|65.535] "lambda"', "lambda_measured"),
    ],
)
def test_what_only_resembles_is_not_proposed(signal: str, canonical: str) -> None:
    assert canonical not in found(database_of(signal))


@pytest.mark.parametrize(
    ("message", "signal"),
    [
        ("WHEEL_SPEEDS", 'FR (0.005,-100) [0|250] ""'),
        ("Cruise", 'SET_SPEED (0.1,0) [0|250] "km/h"'),
        ("TSK_07", 'TSK_Wunschgeschw (0.32,0) [0|327] "km/h"'),
        ("Seat_Massage", 'SeatAmbientPressure (0.01,0) [0|600] "kPa"'),
        ("LTA_RELATED", 'LDA_SA_TOGGLE (1,0) [0|1] ""'),
        ("BAT11", 'BAT_SNSR_Invalid (1,0) [0|1] ""'),
        ("EMS16", 'PRE_FUEL_CUT_IN (1,0) [0|1] ""'),
        ("TCU12", 'FUEL_CUT_TCU (1,0) [0|1] ""'),
        ("Motor_10", 'MO_rel_Saugrohrdruck (18,0) [0|1134] "mbar"'),
        ("Motor_7", 'Ladedruck (0.01,0) [0|2.5] "bar"'),
        ("CLU15", 'VehicleSpeed (1,0) [0|255] ""'),
        ("DI_torque1", 'DI_motorRPM (1,0) [0|65535] "RPM"'),
        ("DI_torque", 'DI_torqueActual (2,0) [0|8000] "Nm"'),
        ("Status_2", 'MotorTemp (1,-40) [-40|215] "degC"'),
        ("Motor_Status_2", 'Torque_Actual -(0.1,0) [-400|400] "Nm"'),
        ("Hybrid_1", 'BatteryVoltage (0.2,0) [0|800] "V"'),
        ("Pack_1", 'BatteryVoltage (0.01,0) [0|655.35] "V"'),
        ("VCU_1", 'FuelCut (1,0) [0|1] ""'),
        ("Status_A1", 'Charger_Ambient_Temp (1,-64) [-64|191] "C"'),
        ("Engine_1", 'TrailerPressure (0.1,0) [0|300] "bar"'),  # holds "rail"
        ("Engine_1", 'CVT_RPM (1,0) [0|8000] "rpm"'),  # a bare quantity of another machine
        ("Engine_1", 'Inlet_Coolant_Temp (1,-40) [-40|215] ""'),  # of a battery or a cooler
        ("Engine_1", 'MAP (0.01,0) [0|400] "mpa"'),  # a unit too large for its range
        ("Radar_Object", 'Speed (0.07,0) [0|71] "km/h"'),
        ("Manifold", 'EngMnfldPress (0.1,-206) [-206|600] "kPa"'),
        ("IC1", 'EngIntakeManifold1Press (2,0) [0|500] "kPa"'),  # SPN 102 is a gauge's
        ("Engine_1", 'SensorSupplyVoltage (0.001,0) [0|16] "V"'),
    ],
)
def test_a_signal_of_another_quantity_stays_a_comment(message: str, signal: str) -> None:
    text, proposals = proposed(database_of(signal, message=message))
    assert proposals.names == ()
    lines = [line for line in text.splitlines() if "message =" in line]
    assert all(line.startswith("#") for line in lines)
    assert signal != 'VehicleSpeed (1,0) [0|255] ""' or ": no unit is given" in text
