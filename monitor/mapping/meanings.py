"""What a database may call each canonical signal, in which units, and what it is not."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from monitor.mapping.words import Phrase


@dataclass(frozen=True, slots=True)
class Meaning:
    """One canonical signal as others may call it."""

    phrases: tuple[Phrase, ...]
    dimensions: Mapping[str, float]  # dimension → canonical unit per base unit
    typical: tuple[float, float]  # a signal that cannot carry these values is another one
    without_unit: float = 0.85  # confidence left when there is no unit
    never: frozenset[str] = frozenset()  # words of something else
    is_flag: bool = False


def _phrases(*weighted: tuple[str, float]) -> tuple[Phrase, ...]:
    return tuple(Phrase(tuple(text.split()), weight) for text, weight in weighted)


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


def _never(text: str) -> frozenset[str]:
    return frozenset(text.split())


# stems anywhere in a name that make it another quantity, a limit or a state
OTHER: Final = _words(
    "max min limit grenz gradient grad_ delta diff deviation abweich error fehler fault status "
    "valid_ qualifier quality gueltig counter checksum crc botschaftsz ersatz default substitut "
    "heater heiz resist nernst pump voltage_raw adc integr predict average learn adapt longterm "
    "warn lamp request"
)
_LAMBDA_NOT: Final = _never(
    "heater heiz temp temperature temperatur resistance ri nernst pump ip duty voltage volt "
    "current strom status error fault esr age count counter integrator learn adapt ltft long"
)

_TARGET: Final = _never(
    "target tgt trg soll sollwert setpoint setp sp desired des commanded command cmd cmded demand "
    "dmd request requested req wanted lambdasoll lamsoll lamsons lamsbg"
)

MEANINGS: Final[dict[str, Meaning]] = {
    "lambda_measured": Meaning(
        _phrases(
            ("lambda", 0.9),
            ("lambda_measured", 1.0),
            ("lambda sensor", 0.97),
            ("airfuel ratio", 0.9),
            ("air fuel ratio", 0.95),
            ("equivalence ratio", 0.95),
            ("equivalence", 0.75),
            ("equivalence sensor", 0.9),
        ),
        {"number": 1.0, "afr": 1 / 14.7, "phi": 1.0},
        (0.85, 1.15),
        without_unit=1.0,
        never=_LAMBDA_NOT
        | _TARGET
        | _never(
            "trim correction control controller regler faktor factor stft "
            "valid ready rdy active aktiv enable closed loop dfco"
        ),
    ),
    "lambda_target": Meaning(
        _phrases(
            ("lambda target", 1.0),
            ("lambda_target", 1.0),
            ("airfuel ratio target", 0.95),
            ("air fuel ratio target", 0.95),
            ("equivalence target", 0.95),
        ),
        {"number": 1.0, "afr": 1 / 14.7, "phi": 1.0},
        (0.85, 1.05),
        without_unit=1.0,
        never=_LAMBDA_NOT | _never("trim correction active valid"),
    ),
    "lambda_controller": Meaning(
        _phrases(
            ("lambda control", 1.0),
            ("fuel trim short", 1.0),
            ("fuel trim", 0.9),
            ("trim short", 0.9),
            ("fr", 0.75),
            ("fuel control", 0.75),
            ("trim", 0.6),
            ("sensor control", 0.7),
        ),
        {"number": 1.0, "ratio": 1.0},
        (0.92, 1.08),
        without_unit=0.95,
        never=_never(
            "ltft long longterm target soll active aktiv status enable valid ready pump "
            "flow pressure limit learn adapt state loop duty temp duration freigabe on"
        ),
    ),
    "fuel_mass_mg": Meaning(
        _phrases(
            ("fuel mass", 1.0),
            ("injection mass", 1.0),
            ("fuel cylinder", 0.9),
            ("fuel injection", 0.7),
        ),
        {"mass": 1.0, "volume": 0.745},
        (3.0, 40.0),
        without_unit=0.0,
        never=_never("air luft tank level"),
    ),
    "air_mass_mg": Meaning(
        _phrases(("air mass", 1.0), ("cylinder mass", 0.85), ("air cylinder", 0.95), ("air", 0.6)),
        {"mass": 1.0},
        (80.0, 500.0),
        without_unit=0.0,
        never=_never("fuel kraftstoff temp target"),
    ),
    "maf_kg_h": Meaning(
        _phrases(("maf", 1.0), ("air mass flow", 1.0), ("air mass", 0.9), ("air flow", 0.9)),
        {"mass_flow": 1.0},
        (8.0, 150.0),
        without_unit=0.5,
        never=_never("fuel kraftstoff temp exhaust abgas egr agr target soll"),
    ),
    "rail_pressure_mpa": Meaning(
        _phrases(
            ("rail pressure", 1.0),
            ("fuel pressure high", 1.0),
            ("fuel pressure", 0.75),
            ("rail", 0.8),
            ("pressure high", 0.75),
        ),
        {"pressure": 1e-3},
        (4.0, 15.0),
        without_unit=0.5,
        never=_never("low nieder nd oil oel target soll brake bremse lp tank valve"),
    ),
    "manifold_pressure_kpa": Meaning(
        _phrases(
            ("map", 0.95),
            ("manifold pressure", 1.0),
            ("boost pressure", 0.65),
            ("boost", 0.5),
            ("air pressure", 0.5),
        ),
        {"pressure": 1.0},
        (30.0, 95.0),
        without_unit=0.7,
        never=_never("exhaust abgas egr target soll temp fuel oil oel baro ambient gauge tire"),
    ),
    "manifold_temperature_degc": Meaning(
        _phrases(("manifold temperature", 1.0), ("iat", 0.95), ("air temperature", 0.8)),
        {"temperature": 1.0},
        (0.0, 50.0),
        never=_never(
            "exhaust abgas egr ambient amb outside aussen umgebung target cabin innenraum "
            "coolant oil ac evaporator"
        ),
    ),
    "coolant_temperature_degc": Meaning(
        _phrases(
            ("coolant temperature", 1.0),
            ("ect", 0.95),
            ("coolant", 0.75),
            ("engine temperature", 0.8),
        ),
        {"temperature": 1.0},
        (20.0, 95.0),
        never=_never(
            "oil oel trans gear getriebe intercooler llk inverter battery exhaust target "
            "soll air intake fan lamp ambient outside aussen fuel manifold charge"
        ),
    ),
    "ambient_temperature_degc": Meaning(
        _phrases(("ambient temperature", 1.0), ("outside_air", 0.95), ("aat", 0.9)),
        {"temperature": 1.0},
        (0.0, 30.0),
        never=_never("coolant engine intake"),
    ),
    "ambient_pressure_kpa": Meaning(
        _phrases(("ambient pressure", 1.0), ("baro pressure", 1.0), ("baro", 0.95)),
        {"pressure": 1.0},
        (80.0, 101.0),
        without_unit=0.75,
        never=_never("manifold temp tire"),
    ),
    "engine_speed_rpm": Meaning(
        _phrases(
            ("engine speed", 1.0),
            ("engine rpm", 1.0),
            ("rpm", 0.9),
            ("revolutions", 0.8),
            ("engine n", 0.8),
        ),
        {"rotation": 1.0},
        (800.0, 4000.0),
        never=_never(
            "wheel rad turbo atl fan luefter pump input output turbine gear getriebe "
            "shaft target soll idle leerlauf vehicle fahrzeug abs esp e hybrid generator "
            "alternator abtrieb turbin oil clutch compressor wiper"
        ),
    ),
    "vehicle_speed_km_h": Meaning(
        _phrases(
            ("vehicle speed", 1.0), ("vehicle v", 0.75), ("geschwindigkeit", 0.9), ("speed", 0.55)
        ),
        {"speed": 1.0},
        (10.0, 120.0),
        never=_never(
            "engine eng motor rpm wheel rad fan luefter target soll set cruise limit gra "
            "acc wind turbo pump front rear left right fl fr rl rr vl vr hl hr"
        ),
    ),
    "engine_torque_nm": Meaning(
        _phrases(("engine torque", 1.0), ("torque", 0.7)),
        {"torque": 1.0},
        (10.0, 120.0),
        without_unit=0.6,
        never=_never(
            "target soll demand driver fahrer wunsch request loss verlust friction reib "
            "reference ref brake wheel steering lenk clutch kupplung gear limit converter "
            "desired command e electric motor1 motor2 generator"
        ),
    ),
    "throttle_percent": Meaning(
        _phrases(("throttle position", 1.0), ("throttle", 0.95)),
        {"ratio": 100.0},
        (3.0, 80.0),
        without_unit=0.7,
        never=_never("pedal pps app fahrpedal accelerator acc target soll idle driver motor temp"),
    ),
    "battery_voltage_v": Meaning(
        _phrases(("battery voltage", 1.0), ("battery", 0.7)),
        {"voltage": 1.0},
        (11.5, 14.5),
        without_unit=0.7,
        never=_never(
            "hv hybrid traction cell zelle target soll temp soc current strom sensor "
            "lambda nernst throttle tps"
        ),
    ),
    "purge_duty_percent": Meaning(
        _phrases(("purge duty", 1.0), ("purge", 0.8)),
        {"ratio": 100.0},
        (2.0, 80.0),
        without_unit=0.75,
        never=_never("pressure temp leak level status active"),
    ),
    "closed_loop": Meaning(
        _phrases(("closed loop", 1.0), ("lambda control active", 0.95), ("b_lr", 0.9)),
        {"number": 1.0},
        (1.0, 1.0),
        without_unit=1.0,
        is_flag=True,
        never=_never("idle cruise boost vvt temp correction speed"),
    ),
    "fuel_cut": Meaning(
        _phrases(("fuel cut", 1.0), ("dfco", 0.9)),
        {"number": 1.0},
        (1.0, 1.0),
        without_unit=1.0,
        is_flag=True,
        never=_never("speed rpm limiter crash ignition count time"),
    ),
    "sensor_ready": Meaning(
        _phrases(
            ("lambda sensor ready", 1.0),
            ("lambda ready", 0.95),
            ("sensor ready", 0.95),
            ("b_sbb", 0.9),
        ),
        {"number": 1.0},
        (1.0, 1.0),
        without_unit=1.0,
        is_flag=True,
        never=_never("cam crank knock speed temp pressure abs"),
    ),
}

# what is not canonical but helps to derive fuel per stroke
FUEL_FLOW: Final = Meaning(
    _phrases(
        ("fuel flow", 1.0), ("fuel consumption", 0.9), ("injection flow", 0.8), ("consumption", 0.7)
    ),
    {"mass_flow": 1.0, "volume_flow": 0.745},
    (0.3, 15.0),
    without_unit=0.0,
    never=_never("pump return average trip total target range"),
)
LAMBDA_FAMILY: Final = frozenset(
    {"lambda_measured", "lambda_controller", "sensor_ready", "lambda_target"}
)
OF_ONE_SENSOR: Final = LAMBDA_FAMILY - {"lambda_target"}  # must be upstream, of the first bank
VARYING: Final = frozenset(
    {
        "lambda_measured",
        "maf_kg_h",
        "air_mass_mg",
        "fuel_mass_mg",
        "manifold_pressure_kpa",
        "engine_speed_rpm",
        "vehicle_speed_km_h",
        "throttle_percent",
        "lambda_controller",
        "rail_pressure_mpa",
        "engine_torque_nm",
    }
)
TOGETHER: Final = (  # rise and fall together while driving
    ("maf_kg_h", "engine_speed_rpm"),
    ("air_mass_mg", "manifold_pressure_kpa"),
    ("fuel_mass_mg", "manifold_pressure_kpa"),
    ("manifold_pressure_kpa", "throttle_percent"),
    ("engine_torque_nm", "manifold_pressure_kpa"),
    ("vehicle_speed_km_h", "engine_speed_rpm"),
)
