"""Effects without a physics: the mixture or the fuel as a function of one recorded signal.

The name of such an effect says its form, so that a model's card needs nothing else:
``empirical:SIGNAL:FORM:AT:WIDTH``. With u = (signal - AT) / WIDTH the forms are

    factor   the mixture times 1 + c u
    mass     fuel per injection plus c u
    slow     as factor, with u behind a lag of first order
    curve    the mixture times 1 + a curve, linear between five values of u from -1 to 1
"""

from typing import Final

from monitor.base.errors import ModelError
from training.greybox.effects.form.effect import Effect, Parameter, Values
from training.greybox.effects.form.place import Place
from training.greybox.effects.form.value import Quantity, clip, maximum

PREFIX: Final = "empirical"
KNOTS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of u
PERCENT: Final = 100.0
STATES: Final = 2  # of a lag: its value, and whether it has begun
_SIZE: Final = Parameter("size", "%", -40.0, 40.0, (1.0, -1.0))
_FORMS: Final = {
    "factor": (_SIZE,),
    "mass": (Parameter("size", "mg/stroke", -8.0, 8.0, (0.1, -0.1)),),
    "slow": (_SIZE, Parameter("time", "s", 0.3, 60.0, (2.0, 15.0))),
    "curve": tuple(Parameter(f"at {u:+g}", "%", -40.0, 40.0, (0.5,)) for u in KNOTS),
}
FORMS: Final = tuple(_FORMS)


def is_empirical(name: str) -> bool:
    """Return whether the name is one of an empirical effect."""
    return name.startswith(f"{PREFIX}:")


def name_of(signal: str, form: str, at: float, width: float) -> str:
    """Return the effect's name.

    >>> name_of("manifold_temperature_degc", "factor", 30.0, 20.0)
    'empirical:manifold_temperature_degc:factor:30:20'
    """
    return f"{PREFIX}:{signal}:{form}:{at:.6g}:{width:.6g}"


def effect_of(name: str) -> Effect:
    """Return the effect that a name says; raises ModelError if it says none."""
    try:
        _, signal, form, at, width = name.split(":")
        parameters, centre, scale = _FORMS[form], float(at), float(width)
    except (ValueError, KeyError):
        raise ModelError(f"{name!r} is no empirical effect") from None

    def equation(place: Place, values: Values) -> dict[str, Quantity]:
        u = clip((place.signal(signal) - centre) * (1.0 / scale), -3.0, 3.0)
        if form == "mass":
            return {"fuel_mg": maximum(place.of("fuel_mg") + values[0] * u, 0.0)}
        if form == "slow":
            u = place.lag(u + 4.0, values[1]) - 4.0
        change = values[0] * u if form != "curve" else _curve(u, values)
        return {"factor": place.of("factor") * (1.0 + change * (1.0 / PERCENT))}

    return Effect(
        name=name,
        says=f"the mixture goes with {signal.replace('_', ' ')}",
        parameters=parameters,
        needs=(signal,),
        tag="physics",
        source="found in the recordings",
        equation=equation,
        n_states=STATES if form == "slow" else 0,
    )


def _curve(u: Quantity, values: Values) -> Quantity:
    """Return the curve through ``values`` at the knots, constant beyond them."""
    inside = clip(u, KNOTS[0], KNOTS[-1])
    total: Quantity = 0.0
    for knot, value in zip(KNOTS, values, strict=True):
        away = maximum(inside - knot, knot - inside)
        total = maximum(1.0 - away * 2.0, 0.0) * value + total
    return total


def formula(name: str, values: Values) -> str:
    """Return the effect with its constants as a formula.

    >>> formula("empirical:manifold_temperature_degc:factor:30:20", [-1.76])
    'mixture × (1 - 0.088 % per unit of (manifold_temperature_degc - 30))'
    """
    _, signal, form, at, width = name.split(":")
    size, scale = values[0], float(width)
    sign, per = "-" if size < 0 else "+", abs(size) / scale
    if form == "factor":
        return f"mixture × (1 {sign} {per:.3g} % per unit of ({signal} - {at}))"
    if form == "mass":
        return f"fuel {sign} {per:.3g} mg/stroke per unit of ({signal} - {at})"
    if form == "slow":
        late = f"{signal} behind a lag of {values[1]:.3g} s"
        return f"mixture × (1 {sign} {per:.3g} % per unit of ({late} - {at}))"
    points = ", ".join(
        f"{v:+.3g} % at {float(at) + u * scale:.4g}" for u, v in zip(KNOTS, values, strict=True)
    )
    return f"mixture × (1 + curve of {signal}: {points})"
