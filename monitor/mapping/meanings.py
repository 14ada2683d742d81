"""Each canonical signal as databases may describe it: its names, units and values."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from monitor.mapping.vocabulary import carried


@dataclass(frozen=True, slots=True)
class Meaning:
    """One canonical signal as a database may describe it."""

    phrases: Mapping[str, float]  # see ``vocabulary.match``
    dimensions: Mapping[str, float]  # dimension → canonical unit per base unit
    typical: tuple[float, float]  # a signal that cannot carry these values is another quantity
    without_unit: float  # confidence that is left without a unit
    never: frozenset[str]  # words of another quantity
    others: frozenset[str]  # stems of ``OTHER`` that its own concepts do not carry
    is_flag: bool


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _meaning(
    phrases: str,
    dimensions: Mapping[str, float],
    typical: tuple[float, float],
    *,
    without_unit: float = 0.85,
    never: str,
    is_flag: bool = False,
) -> Meaning:
    """Return a meaning; ``phrases`` as "concept concept 1.0, concept 0.9"."""
    pairs = (each.strip().rsplit(" ", 1) for each in phrases.split(","))
    weights = {concepts: float(weight) for concepts, weight in pairs}
    return Meaning(
        phrases=weights,
        dimensions=dimensions,
        typical=typical,
        without_unit=without_unit,
        never=_words(never),
        others=OTHER - carried(weights),
        is_flag=is_flag,
    )


def _flag(phrases: str, never: str) -> Meaning:
    unitless, on = {"number": 1.0}, (1.0, 1.0)
    return _meaning(phrases, unitless, on, without_unit=1.0, never=never, is_flag=True)


# stems anywhere in a name that make it another quantity, a limit or a state
OTHER: Final = _words(
    "max min limit grenz gradient grad_ delta diff deviation abweich error fehler fault status "
    "valid_ qualifier quality gueltig counter checksum crc botschaftsz ersatz default substitut "
    "heater heiz resist nernst pump voltage_raw adc integr predict average learn adapt longterm "
    "warn lamp request"
)
_LAMBDA_NOT: Final = (
    "heater heiz temp temperature temperatur resistance ri nernst pump ip duty voltage volt "
    "current strom status error fault esr age count counter integrator learn adapt ltft long"
)
_TARGET: Final = (
    "target tgt trg soll sollwert setpoint setp sp desired des commanded command cmd cmded demand "
    "dmd request requested req wanted lambdasoll lamsoll lamsons lamsbg"
)

MEANINGS: Final[dict[str, Meaning]] = {
    "lambda_measured": _meaning(
        "lambda 0.9, lambda_measured 1.0, lambda sensor 0.97, airfuel ratio 0.9, "
        "air fuel ratio 0.95, equivalence ratio 0.95, equivalence 0.75, equivalence sensor 0.9",
        {"number": 1.0, "afr": 1 / 14.7, "phi": 1.0},
        (0.85, 1.15),
        without_unit=1.0,
        never=f"{_LAMBDA_NOT} {_TARGET} trim correction control controller regler faktor factor "
        "stft valid ready rdy active aktiv enable closed loop dfco",
    ),
    "lambda_target": _meaning(
        "lambda target 1.0, lambda_target 1.0, airfuel ratio target 0.95, "
        "air fuel ratio target 0.95, equivalence target 0.95",
        {"number": 1.0, "afr": 1 / 14.7, "phi": 1.0},
        (0.85, 1.05),
        without_unit=1.0,
        never=f"{_LAMBDA_NOT} trim correction active valid",
    ),
    "lambda_controller": _meaning(
        "lambda control 1.0, fuel trim short 1.0, fuel trim 0.9, trim short 0.9, fr 0.75, "
        "fuel control 0.75, trim 0.6, sensor control 0.7",
        {"number": 1.0, "ratio": 1.0},
        (0.92, 1.08),
        without_unit=0.95,
        never="ltft long longterm target soll active aktiv status enable valid ready pump flow "
        "pressure limit learn adapt state loop duty temp duration freigabe on",
    ),
    "fuel_mass_mg": _meaning(
        "fuel mass 1.0, injection mass 1.0, fuel cylinder 0.9, fuel injection 0.7",
        {"mass": 1.0, "volume": 0.745},
        (3.0, 40.0),
        without_unit=0.0,
        never="air luft tank level",
    ),
    "air_mass_mg": _meaning(
        "air mass 1.0, cylinder mass 0.85, air cylinder 0.95, air 0.6",
        {"mass": 1.0},
        (80.0, 500.0),
        without_unit=0.0,
        never="fuel kraftstoff temp target",
    ),
    "maf_kg_h": _meaning(
        "maf 1.0, air mass flow 1.0, air mass 0.9, air flow 0.9",
        {"mass_flow": 1.0},
        (8.0, 150.0),
        without_unit=0.5,
        never="fuel kraftstoff temp exhaust abgas egr agr target soll",
    ),
    "rail_pressure_mpa": _meaning(
        "rail pressure 1.0, fuel pressure high 1.0, fuel pressure 0.75, rail 0.8, "
        "pressure high 0.75",
        {"pressure": 0.001},
        (4.0, 15.0),
        without_unit=0.5,
        never="low nieder nd oil oel target soll brake bremse lp tank valve",
    ),
    "manifold_pressure_kpa": _meaning(
        "map 0.95, manifold pressure 1.0, boost pressure 0.65, boost 0.5, air pressure 0.5",
        {"pressure": 1.0},
        (30.0, 95.0),
        without_unit=0.7,
        never="exhaust abgas egr target soll temp fuel oil oel baro ambient gauge tire",
    ),
    "manifold_temperature_degc": _meaning(
        "manifold temperature 1.0, iat 0.95, air temperature 0.8",
        {"temperature": 1.0},
        (0.0, 50.0),
        never="exhaust abgas egr ambient amb outside ots aussen umgebung target cabin innenraum "
        "coolant oil ac evaporator",
    ),
    "coolant_temperature_degc": _meaning(
        "coolant temperature 1.0, ect 0.95, coolant 0.75, engine temperature 0.8",
        {"temperature": 1.0},
        (20.0, 85.0),  # the thermostat is open
        never="oil oel trans gear getriebe intercooler llk inverter battery exhaust target soll "
        "air intake fan lamp ambient outside aussen fuel manifold charge",
    ),
    "ambient_temperature_degc": _meaning(
        "ambient temperature 1.0, outside_air 0.95, aat 0.9",
        {"temperature": 1.0},
        (0.0, 30.0),
        never="coolant engine intake",
    ),
    "ambient_pressure_kpa": _meaning(
        "ambient pressure 1.0, baro pressure 1.0, baro 0.95",
        {"pressure": 1.0},
        (80.0, 104.0),
        without_unit=0.75,
        never="manifold temp tire",
    ),
    "engine_speed_rpm": _meaning(
        "engine speed 1.0, engine rpm 1.0, rpm 0.9, revolutions 0.8, engine n 0.8",
        {"rotation": 1.0},
        (800.0, 4000.0),
        never="wheel rad turbo atl fan luefter pump input output turbine gear getriebe shaft "
        "target soll idle leerlauf vehicle fahrzeug abs esp e hybrid generator alternator abtrieb "
        "turbin oil clutch compressor wiper",
    ),
    "vehicle_speed_km_h": _meaning(
        "vehicle speed 1.0, vehicle v 0.75, geschwindigkeit 0.9, speed 0.65",
        {"speed": 1.0},
        (10.0, 120.0),
        never="engine eng motor rpm wheel rad fan luefter target soll set cruise limit gra acc "
        "wind turbo pump front rear left right fl fr rl rr vl vr hl hr",
    ),
    "engine_torque_nm": _meaning(
        "engine torque 1.0, torque 0.7",
        {"torque": 1.0},
        (10.0, 120.0),
        without_unit=0.6,
        never="target soll demand driver fahrer wunsch request loss verlust friction reib "
        "reference ref brake wheel steering lenk clutch kupplung gear limit converter desired "
        "command e electric motor1 motor2 generator",
    ),
    "throttle_percent": _meaning(
        "throttle position 1.0, throttle 0.95",
        {"ratio": 100.0},
        (3.0, 80.0),
        without_unit=0.7,
        never="pedal pps app fahrpedal accelerator acc target soll idle driver motor temp",
    ),
    "battery_voltage_v": _meaning(
        "battery voltage 1.0, battery 0.7",
        {"voltage": 1.0},
        (11.5, 14.5),
        without_unit=0.7,
        never="hv hybrid traction cell zelle target soll temp soc current strom sensor lambda "
        "nernst throttle tps",
    ),
    "purge_duty_percent": _meaning(
        "purge duty 1.0, purge 0.8",
        {"ratio": 100.0},
        (2.0, 80.0),
        without_unit=0.75,
        never="pressure temp leak level status active",
    ),
    "sensor_heater_percent": _meaning(
        "lambda sensor heater duty 1.0, sensor heater 1.0, lambda heater duty 0.9",
        {"ratio": 100.0},
        (10.0, 90.0),
        without_unit=0.0,
        never="seat window screen mirror steering cabin coolant oil urea adblue nox temp current "
        "resistance power status active error target",
    ),
    "closed_loop": _flag(
        "closed loop 1.0, lambda control active 0.95, b_lr 0.9",
        never="idle cruise boost vvt temp correction speed",
    ),
    "fuel_cut": _flag(
        "fuel cut 1.0, dfco 0.9",
        never="speed rpm limiter crash ignition count time",
    ),
    "sensor_ready": _flag(
        "lambda sensor ready 1.0, lambda ready 0.95, oxygen sensor ready 0.95, b_sbb 0.9",
        never="cam crank knock speed temp pressure abs",
    ),
}
# not canonical: fuel per stroke follows from it
FUEL_FLOW: Final = _meaning(
    "fuel flow 1.0, fuel consumption 0.9, injection flow 0.8, consumption 0.7",
    {"mass_flow": 1.0, "volume_flow": 0.745},
    (0.3, 15.0),
    without_unit=0.0,
    never="pump return average trip total target range",
)
LAMBDA_FAMILY: Final = frozenset(
    {"lambda_measured", "lambda_controller", "sensor_ready", "lambda_target"}
)
# must be upstream, of the first bank
OF_ONE_SENSOR: Final = LAMBDA_FAMILY - {"lambda_target"} | {"sensor_heater_percent"}
VARYING: Final = _words(  # move while a vehicle is driven
    "lambda_measured lambda_controller maf_kg_h air_mass_mg fuel_mass_mg "
    "manifold_pressure_kpa engine_speed_rpm vehicle_speed_km_h throttle_percent "
    "rail_pressure_mpa engine_torque_nm"
)
TOGETHER: Final = (  # rise and fall together while driving
    ("maf_kg_h", "engine_speed_rpm"),
    ("air_mass_mg", "manifold_pressure_kpa"),
    ("fuel_mass_mg", "manifold_pressure_kpa"),
    ("manifold_pressure_kpa", "throttle_percent"),
    ("engine_torque_nm", "manifold_pressure_kpa"),
    ("vehicle_speed_km_h", "engine_speed_rpm"),
)
