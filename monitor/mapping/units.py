"""Units as databases write them, and what brings them to the canonical one."""

import re
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: value in the dimension's base unit = factor * value + offset."""

    dimension: str
    factor: float = 1.0
    offset: float = 0.0


_TABLE: Final[dict[str, tuple[Unit, str]]] = {
    # base kPa
    "kpa": (Unit("pressure"), "kpa kpaa kpaabs kpa(abs) kpa_abs kpag kilopascal"),
    "bar": (Unit("pressure", 100.0), "bar bara barabs barg"),
    "hpa": (Unit("pressure", 0.1), "hpa millibar mbar mbarabs hpaabs hpa_abs mbara"),
    "pa": (Unit("pressure", 0.001), "pa"),
    "mpa": (Unit("pressure", 1000.0), "mpa"),
    "psi": (Unit("pressure", 6.894757), "psi psia psig"),
    "inhg": (Unit("pressure", 3.386389), "inhg"),
    "mmhg": (Unit("pressure", 0.1333224), "mmhg torr"),
    "at": (Unit("pressure", 98.0665), "kgf/cm2 kg/cm2 at"),
    # base degC
    "degc": (
        Unit("temperature"),
        "degc c °c celsius gradc grad_c gradcelsius deg_c ºc grdc"
        " degrecelsi degreecelsius degreescelsius",
    ),
    "degf": (Unit("temperature", 5 / 9, -160 / 9), "degf f °f fahrenheit deg_f ºf"),
    "kelvin": (Unit("temperature", 1.0, -273.15), "k kelvin degk °k"),
    # base kg/h
    "kg/h": (Unit("mass_flow"), "kg/h kgh kg/hr kgph kg/std"),
    "g/s": (Unit("mass_flow", 3.6), "g/s gps g/sec"),
    "kg/s": (Unit("mass_flow", 3600.0), "kg/s"),
    "kg/min": (Unit("mass_flow", 60.0), "kg/min"),
    "g/min": (Unit("mass_flow", 0.06), "g/min"),
    "mg/s": (Unit("mass_flow", 0.0036), "mg/s"),
    "g/h": (Unit("mass_flow", 0.001), "g/h"),
    "lb/min": (Unit("mass_flow", 27.21554), "lb/min lbs/min lb/m ppm_air"),
    "lb/h": (Unit("mass_flow", 0.4535924), "lb/h lb/hr lbs/h lbs/hr pph"),
    # base l/h
    "l/h": (Unit("volume_flow"), "l/h lph l/hr l/std liter/h"),
    "ml/min": (Unit("volume_flow", 0.06), "ml/min cc/min ccm cm3/min"),
    "ml/s": (Unit("volume_flow", 3.6), "ml/s cc/s cm3/s"),
    "ul/s": (Unit("volume_flow", 0.0036), "ul/s mm3/s µl/s"),
    "gal/h": (Unit("volume_flow", 3.785412), "gal/h gph gal/hr"),
    # base mg per stroke of one cylinder
    "mg": (Unit("mass"), "mg mg/stk mg/stroke mg/str mg/hub mg/cyl mg/zyl mg/inj mg/asp mg/cycle"),
    "g": (Unit("mass", 1000.0), "g g/stroke g/stk g/cyl g/hub"),
    "mm3": (Unit("volume"), "mm3 mm3/stk mm3/stroke mm3/hub ul µl mm^3/stroke mm³/hub"),
    # base 1/min
    "rpm": (
        Unit("rotation"),
        "rpm 1/min u/min /min min-1 min^-1 upm r/min rev/min tr/min umin "
        "rev/minute umdr/min minutinver",
    ),
    "1/s": (Unit("rotation", 60.0), "1/s rps hz u/s rev/s"),
    "rad/s": (Unit("rotation", 9.549297), "rad/s"),
    # base km/h
    "km/h": (Unit("speed"), "km/h kmh kph kmph km/std kilometerperhour kilometperhour"),
    "mph": (Unit("speed", 1.609344), "mph mi/h miles/h"),
    "m/s": (Unit("speed", 3.6), "m/s"),
    # base Nm
    "nm": (Unit("torque"), "nm n.m n*m newtonmeter n-m newtometer newtonmeter"),
    "lbft": (Unit("torque", 1.355818), "lbft lb-ft lb*ft ftlb ft-lb lbfft ft.lb"),
    # base V
    "v": (Unit("voltage"), "v volt volts vdc"),
    "mv": (Unit("voltage", 0.001), "mv millivolt"),
    # base 1
    "%": (Unit("ratio", 0.01), "% percent pct prozent proz"),
    "permille": (Unit("ratio", 0.001), "‰ permille promille"),
    "-": (
        Unit("number"),
        "- 1 la ratio none lambda lam λ unitless factor n/a bit bool boolean on/off flag lambdas",
    ),
    "afr": (Unit("afr"), "afr :1 a/f kg/kg g/g af afratio"),
    "phi": (Unit("phi"), "phi φ er eqr"),
    # known, and never one of ours
    "other": (
        Unit("other"),
        "microliter "
        "ms s sec min h us km m mm a ma w kw hp ps ohm kohm deg ° °kw degkw "
        "degca °crk grd grad l ml kg count counts g/km l/100km mpg mw rad j kj n kn km/l day "
        "month year hour minute second ° ca degbtdc m/s2 m/s^2 deg/s °/s kwh ah %/s nm/s",
    ),
}
_ALIASES: Final = {
    alias: unit for unit, aliases in _TABLE.values() for alias in aliases.split() if alias
}


def unit_of(text: str | None) -> Unit | None:
    """Return the unit a database gives; None if it gives none or one that is not known.

    >>> unit_of("U/min").dimension
    'rotation'
    >>> round(unit_of("°F").factor * 212 + unit_of("°F").offset, 9)
    100.0
    >>> unit_of("furlong") is None
    True
    """
    plain = re.sub(r"[\s\[\]]", "", (text or "").lower()).replace("unit_", "")
    plain = plain.replace("grad c", "degc").replace("\xba", "°")
    return _ALIASES.get(plain) or _ALIASES.get(plain.strip("()"))
