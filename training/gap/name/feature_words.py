"""The plain functions of a drive in words, with the unit of their coefficients."""

from typing import Final, NamedTuple

from training.healthy.features import COOLANT_KNOTS_DEGC, LOAD_KNOTS_MG, SPEED_KNOTS_RPM


class Words(NamedTuple):
    """A function in words, and the unit of its coefficient."""

    text: str
    unit: str


_LOW_FLOW: Final = "more at low exhaust flow (times 15 kg/h over it)"
_WITH_FLOW: Final = "more with exhaust flow (times it over 60 kg/h)"
_WORDS: Final = {
    "1/air": Words("a constant mass per stroke (as 100 mg over the charge)", "phi"),
    "charge slope": Words("the charge's relative change", "phi s"),
    "charge slope at low speed": Words(
        "the charge's relative change, more at low engine speed (times 1,500 rpm over it)", "phi s"
    ),
    "fuel slope": Words("the fuel's relative change", "phi s"),
    "rail": Words("the logarithm of rail pressure over 10 MPa", "phi"),
    "rail squared": Words("the squared logarithm of rail pressure over 10 MPa", "phi"),
    "intake": Words("manifold temperature above 30 degC", "phi per 20 K"),
    "intake at low flow": Words(
        "manifold temperature above 30 degC, more at low flow", "phi per 20 K"
    ),
    "boost at low speed": Words(
        "manifold pressure above 0.9 of ambient at low engine speed, relative", "phi"
    ),
    "purge": Words("the purge valve's duty times relative pressure drop", "phi"),
    "purge by flow": Words(
        "the purge valve's duty times relative pressure drop, times 20 kg/h over the flow", "phi"
    ),
    "trim": Words("the lambda controller's correction", "phi"),
    "constant": Words("a constant", "phi"),
    "above": Words("the mixture's distance from stoichiometric", "-"),
    "above by flow": Words(f"the mixture's distance from stoichiometric, {_WITH_FLOW}", "-"),
    "above at low flow": Words(f"the mixture's distance from stoichiometric, {_LOW_FLOW}", "-"),
    "lean": Words("the mixture's distance from stoichiometric, lean only", "-"),
    "rate": Words("the reading's rate of change", "s"),
    "rate at low flow": Words(f"the reading's rate of change, {_LOW_FLOW}", "s"),
    "rate by flow": Words(f"the reading's rate of change, {_WITH_FLOW}", "s"),
    "rising": Words("the reading's rate of change, rising (lean to rich) only", "s"),
    "curve": Words("the reading's second derivative", "s^2"),
    "curve at low flow": Words(f"the reading's second derivative, {_LOW_FLOW}", "s^2"),
    "leak 20": Words("low exhaust flow (falling by e per 20 kg/h)", "phi"),
    "leak 50": Words("low exhaust flow (falling by e per 50 kg/h)", "phi"),
}


def words_of(name: str) -> Words:
    """Return the words for a function of ``features``; raises KeyError if it has none.

    >>> words_of("map 10").text
    'the mixture around 1,300 rpm and 90 mg/stroke'
    """
    if name in _WORDS:
        return _WORDS[name]
    *kind, last = name.split()
    match " ".join(kind):
        case "map":
            rpm, load = SPEED_KNOTS_RPM[int(last[0])], LOAD_KNOTS_MG[int(last[1])]
            return Words(f"the mixture around {rpm:,.0f} rpm and {load:.0f} mg/stroke", "phi")
        case "coolant":
            return Words(f"coolant around {COOLANT_KNOTS_DEGC[int(last)]:.0f} degC", "phi")
        case "fuel film":
            return Words(f"fuel that comes {last} s late, relative", "phi")
        case "cold film":
            return Words(f"fuel that comes {last} s late on a cold engine, relative", "phi")
        case "after cut":
            return Words(f"the time after a fuel cut (fading within {last} s)", "phi")
    raise KeyError(name)
