"""The plain functions of a drive in words, with the unit of their coefficients."""

from typing import Final, NamedTuple

from training.healthy.features import COOLANT_KNOTS_DEGC, LOAD_KNOTS_MG, SPEED_KNOTS_RPM


class FeatureWords(NamedTuple):
    """A function in words, and the unit of its coefficient."""

    text: str
    unit: str


_LOW_FLOW: Final = "more at low exhaust flow (times 15 kg/h over it)"
_WITH_FLOW: Final = "more with exhaust flow (times it over 60 kg/h)"
_WORDS: Final = {
    "1/air": FeatureWords("a constant mass per stroke (as 100 mg over the charge)", "phi"),
    "charge slope": FeatureWords("the charge's relative change", "phi s"),
    "charge slope at low speed": FeatureWords(
        "the charge's relative change, more at low engine speed (times 1,500 rpm over it)", "phi s"
    ),
    "fuel slope": FeatureWords("the fuel's relative change", "phi s"),
    "rail": FeatureWords("the logarithm of rail pressure over 10 MPa", "phi"),
    "rail squared": FeatureWords("the squared logarithm of rail pressure over 10 MPa", "phi"),
    "intake": FeatureWords("manifold temperature above 30 degC", "phi per 20 K"),
    "intake at low flow": FeatureWords(
        "manifold temperature above 30 degC, more at low flow", "phi per 20 K"
    ),
    "boost at low speed": FeatureWords(
        "manifold pressure above 0.9 of ambient at low engine speed, relative", "phi"
    ),
    "purge": FeatureWords("the purge valve's duty times relative pressure drop", "phi"),
    "purge by flow": FeatureWords(
        "the purge valve's duty times relative pressure drop, times 20 kg/h over the flow", "phi"
    ),
    "trim": FeatureWords("the lambda controller's correction", "phi"),
    "constant": FeatureWords("a constant", "phi"),
    "above": FeatureWords("the mixture's distance from stoichiometric", "-"),
    "above by flow": FeatureWords(f"the mixture's distance from stoichiometric, {_WITH_FLOW}", "-"),
    "above at low flow": FeatureWords(
        f"the mixture's distance from stoichiometric, {_LOW_FLOW}", "-"
    ),
    "lean": FeatureWords("the mixture's distance from stoichiometric, lean only", "-"),
    "rate": FeatureWords("the reading's rate of change", "s"),
    "rate at low flow": FeatureWords(f"the reading's rate of change, {_LOW_FLOW}", "s"),
    "rate by flow": FeatureWords(f"the reading's rate of change, {_WITH_FLOW}", "s"),
    "rising": FeatureWords("the reading's rate of change, rising (lean to rich) only", "s"),
    "curve": FeatureWords("the reading's second derivative", "s^2"),
    "curve at low flow": FeatureWords(f"the reading's second derivative, {_LOW_FLOW}", "s^2"),
    "leak 20": FeatureWords("low exhaust flow (falling by e per 20 kg/h)", "phi"),
    "leak 50": FeatureWords("low exhaust flow (falling by e per 50 kg/h)", "phi"),
}


def words_of(name: str) -> FeatureWords:
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
            return FeatureWords(
                f"the mixture around {rpm:,.0f} rpm and {load:.0f} mg/stroke", "phi"
            )
        case "coolant":
            return FeatureWords(f"coolant around {COOLANT_KNOTS_DEGC[int(last)]:.0f} degC", "phi")
        case "fuel film":
            return FeatureWords(f"fuel that comes {last} s late, relative", "phi")
        case "cold film":
            return FeatureWords(f"fuel that comes {last} s late on a cold engine, relative", "phi")
        case "after cut":
            return FeatureWords(f"the time after a fuel cut (fading within {last} s)", "phi")
    raise KeyError(name)
