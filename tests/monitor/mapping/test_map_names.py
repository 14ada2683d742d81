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
GERMAN = """
    engine_speed_rpm          MO_Motordrehzahl (0.25,0) [0|16383] "U/min"
    -                         MO_Kuehlmitteltemperatur (0.75,-48) [-48|143] "Unit_Foo"
    manifold_pressure_kpa     MO_Saugrohrdruck (0.5,0) [0|3500] "hPa"                 = 0.1
    manifold_temperature_degc MO_Ansauglufttemperatur (0.75,-48) [-48|143] "°C"
    maf_kg_h                  MO_Luftmassenstrom (0.1,0) [0|1000] "kg/h"
    rail_pressure_mpa         MO_Raildruck (0.1,0) [0|300] "bar"                      = 0.1
    lambda_measured           MO_Lambda_Istwert (0.0005,0) [0|16] "-"
    lambda_target             MO_Lambda_Sollwert (0.0005,0) [0|16] "-"
    lambda_controller         MO_Lambdaregler (0.001,0) [0|2] "-"
    fuel_mass_mg              MO_Einspritzmenge (0.01,0) [0|200] "mg/Hub"
    vehicle_speed_km_h        ESP_Fahrgeschwindigkeit (0.01,0) [0|300] "km/h"
    throttle_percent          MO_Drosselklappe (0.01,0) [0|100] "%"
    ambient_temperature_degc  MO_Aussentemperatur (0.5,-50) [-50|77] "°C"
    ambient_pressure_kpa      MO_Umgebungsdruck (1,0) [500|1200] "mbar"               = 0.1
    battery_voltage_v         MO_Batteriespannung (0.01,0) [0|20] "V"
    engine_torque_nm          MO_Motormoment (0.1,-500) [-500|1000] "Nm"
"""
ABBREVIATED = """
    engine_speed_rpm          EngSpd (0.25,0) [0|8000] "rpm"
    coolant_temperature_degc  ECT (1,-40) [-40|300] "degF"      = 0.5555556 -17.777778
    manifold_pressure_kpa     MAP_abs (0.01,0) [0|300] "kPa"
    manifold_temperature_degc IAT (1,-40) [-40|300] "°F"        = 0.5555556 -17.777778
    maf_kg_h                  MAF (0.01,0) [0|655] "g/s"        = 3.6
    rail_pressure_mpa         FRP (0.1,0) [0|3000] "psi"        = 0.006894757
    lambda_measured           AFR (0.001,0) [7|25] ""           = 0.0680272
    lambda_controller         STFT_B1 (0.1,-100) [-100|100] "%" = 0.01 1.0
    vehicle_speed_km_h        VehSpd (0.1,0) [0|200] "mph"      = 1.609344
    throttle_percent          TPS (0.1,0) [0|100] "%"
    ambient_pressure_kpa      BaroPress (0.01,0) [0|2] "bar"    = 100.0
    battery_voltage_v         VBatt (1,0) [0|20000] "mV"        = 0.001
    fuel_mass_mg              FuelInjMass (0.01,0) [0|200] "mg"
"""
UNIT_AND_KIND = """
    manifold_pressure_kpa     MAP (0.1,0) [0|6553.5] "pressure:kPa"
    coolant_temperature_degc  CoolantTemp (0.1,0) [0|6553.5] "temperature:F" = 0.5555556 -17.777778
    vehicle_speed_km_h        VehicleSpeed (0.1,0) [0|6553.5] "speed:mph"    = 1.609344
    lambda_measured           ExhaustLambdaUpstreamCatalyst (0.0005,0) [0|16] "-"
"""
NUMBERED = """
    -                         S1_PID_04_CalcEngineLoad (0.4,0) [0|100] "%"
    coolant_temperature_degc  S1_PID_05_EngineCoolantTemp (1,-40) [-40|215] "degC"
    engine_speed_rpm          S1_PID_0C_EngineRPM (0.25,0) [0|16383] "rpm"
    vehicle_speed_km_h        S1_PID_0D_VehicleSpeed (1,0) [0|255] "km/h"
    throttle_percent          S1_PID_11_ThrottlePosition (0.4,0) [0|100] "%"
    lambda_measured           AF_SENS_1_LAMBDA (0.001,0) [0|4] "lambda"
"""
UNIT_IN_NAME = """
    vehicle_speed_km_h        Speed_MPH (1,0) [0|150] ""             = 1.609344
    ambient_temperature_degc  AmbientTemp_F -(1,0) [-60|140] ""      = 0.5555556 -17.777778
    manifold_pressure_kpa     Pressione_collettore_mbar (1,0) [0|2500] "" = 0.1
    coolant_temperature_degc  Temperatura_acqua (1,-40) [-40|215] "C"
    engine_speed_rpm          Giri_motore (1,0) [0|8000] "rpm"
"""
FURTHER = """
    engine_speed_rpm          MO1_Motorvarvtal (0.25,0) [0|8000] "varv/min"
    coolant_temperature_degc  MO2_Koelvloeistoftemperatuur (1,-40) [-40|215] "°C"
    manifold_pressure_kpa     EMS_IntkManPrs_kPa (0.1,0) [0|400] "-"
    throttle_percent          MO3_Posizione_farfalla (0.1,0) [0|100] "%"
    battery_voltage_v         Akkumulator_feszultseg (0.1,0) [0|25] "V"
    lambda_measured           lam_Sonde_vKat (0.000244,0) [0|16] "-"
"""
BOSCH = """
    engine_speed_rpm          nmot_w (0.25,0) [0|16000] "1/min"
    lambda_measured           lamsoni_w (0.000244,0) [0|16] "-"
    lambda_target             lamsons_w (0.000244,0) [0|16] "-"
    lambda_controller         fr_w (0.00003,0) [0|2] "-"
    coolant_temperature_degc  tmot (0.75,-48) [-48|143] "Grad C"
    manifold_temperature_degc tans (0.75,-48) [-48|143] "Grad C"
    manifold_pressure_kpa     ps_w (0.04,0) [0|2500] "hPa"  = 0.1
    maf_kg_h                  ml_w (0.1,0) [0|6500] "kg/h"
    rail_pressure_mpa         prist_w (0.005,0) [0|300] "bar" = 0.1
    vehicle_speed_km_h        vfzg_w (0.008,0) [0|500] "km/h"
    battery_voltage_v         ub (0.1,0) [0|25] "V"
    throttle_percent          wdkba (0.4,0) [0|100] "%"
"""
SAE = """
    engine_speed_rpm          EngSpeed (0.125,0) [0|8031] "rpm"
    coolant_temperature_degc  EngCoolantTemp (1,-40) [-40|210] "°C"
    manifold_pressure_kpa     EngIntakeManifold1Press (2,0) [0|500] "kPa"
    manifold_temperature_degc EngIntakeManifold1Temp (1,-40) [-40|210] "°C"
    ambient_temperature_degc  AmbientAirTemp (0.03125,-273) [-273|1735] "°C"
    ambient_pressure_kpa      BarometricPress (0.5,0) [0|125] "kPa"
    vehicle_speed_km_h        WheelBasedVehicleSpeed (0.00390625,0) [0|250] "km/h"
    maf_kg_h                  EngInletAirMassFlowRate (0.05,0) [0|3212] "kg/h"
    -                         EngOilTemp1 (1,-40) [-40|210] "°C"
    rail_pressure_mpa         EngInjectorMeteringRail1Press (0.00390625,0) [0|250] "MPa"
    lambda_measured           EQ_RAT11 (0.0000305,0) [0|2] ""
    -                         EQ_RAT (0.0000305,0) [0|2] ""
    lambda_controller         SHRTFT1 (0.78125,-100) [-100|99.2] "%"   = 0.01 1.0
"""
BANKS = """
    manifold_pressure_kpa     map1 -(0.1,0) [0|0] "kPa"
    ambient_pressure_kpa      AtmosphericPressure -(0.1,0) [-3276.8|3276.7] "kPa"
    lambda_measured           Wideband_A (0.001,0) [0|65.535] "lambda"
    -                         Wideband_B (0.001,0) [0|65.535] "lambda"
"""


LANGUAGES = [GERMAN, ABBREVIATED, UNIT_AND_KIND, NUMBERED, UNIT_IN_NAME, FURTHER, BOSCH, SAE, BANKS]


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


@pytest.mark.parametrize(("message", "is_engine_s"), [("Status_1", False), ("Engine_1", True)])
def test_a_torque_of_the_engine_s_message_is_the_engine_s(message: str, is_engine_s: bool) -> None:
    signals = 'EstimatedTorque (0.5,-100) [-100|800] "Nm"', 'RPM (1,0) [0|8000] ""'
    assert ("engine_torque_nm" in found(database_of(*signals, message=message))) == is_engine_s


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
    ],
)
def test_a_signal_of_another_quantity_stays_a_comment_with_its_reason(
    message: str, signal: str
) -> None:
    text, proposals = proposed(database_of(signal, message=message))
    assert proposals.names == ()
    lines = [line for line in text.splitlines() if "message =" in line]
    assert all(line.startswith("#") for line in lines)
    assert signal != 'VehicleSpeed (1,0) [0|255] ""' or ": no unit is given" in text
