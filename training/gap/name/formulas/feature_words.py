"""The plain functions of a drive in words."""

from typing import Final

from training.healthy.features import COOLANT_KNOTS_DEGC, LOAD_KNOTS_MG, SPEED_KNOTS_RPM

_LOW_FLOW: Final = "more at low exhaust flow (times 15 kg/h over it)"
_WITH_FLOW: Final = "more with exhaust flow (times it over 60 kg/h)"
_WORDS: Final = {
    "1/air": "a constant mass per stroke (as 100 mg over the charge)",
    "charge slope": "the charge's relative change",
    "charge slope at low speed": "the charge's relative change, more at low engine speed",
    "fuel slope": "the fuel's relative change",
    "rail": "the logarithm of rail pressure over 10 MPa",
    "rail squared": "the squared logarithm of rail pressure over 10 MPa",
    "intake": "manifold temperature above 30 degC",
    "intake at low flow": "manifold temperature above 30 degC, more at low flow",
    "boost at low speed": "manifold pressure above 0.9 of ambient at low engine speed, relative",
    "purge": "the purge valve's duty times relative pressure drop",
    "purge by flow": "the purge valve's duty times relative pressure drop, over the flow",
    "trim": "the lambda controller's correction",
    "constant": "a constant",
    "above": "the mixture's distance from stoichiometric",
    "above by flow": f"the mixture's distance from stoichiometric, {_WITH_FLOW}",
    "above at low flow": f"the mixture's distance from stoichiometric, {_LOW_FLOW}",
    "lean": "the mixture's distance from stoichiometric, lean only",
    "rate": "the reading's rate of change",
    "rate at low flow": f"the reading's rate of change, {_LOW_FLOW}",
    "rate by flow": f"the reading's rate of change, {_WITH_FLOW}",
    "rising": "the reading's rate of change, rising (lean to rich) only",
    "curve": "the reading's second derivative",
    "curve at low flow": f"the reading's second derivative, {_LOW_FLOW}",
    "leak 20": "low exhaust flow (falling by e per 20 kg/h)",
    "leak 50": "low exhaust flow (falling by e per 50 kg/h)",
}


def words_of(name: str) -> str:
    """Return the words for a function of ``features``; raises KeyError if it has none.

    >>> words_of("map 10")
    'the mixture around 1,300 rpm and 90 mg/stroke'
    """
    if name in _WORDS:
        return _WORDS[name]
    *kind, last = name.split()
    match " ".join(kind):
        case "map":
            rpm, load = SPEED_KNOTS_RPM[int(last[0])], LOAD_KNOTS_MG[int(last[1])]
            return f"the mixture around {rpm:,.0f} rpm and {load:.0f} mg/stroke"
        case "coolant":
            return f"coolant around {COOLANT_KNOTS_DEGC[int(last)]:.0f} degC"
        case "fuel film":
            return f"fuel that comes {last} s late, relative"
        case "cold film":
            return f"fuel that comes {last} s late on a cold engine, relative"
        case "after cut":
            return f"the time after a fuel cut (fading within {last} s)"
    raise KeyError(name)
