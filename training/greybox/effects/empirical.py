"""Effects without a physics: the mixture or the fuel as a function of recorded signals.

The name of such an effect says its form, so that a model's card needs nothing else:
``empirical:SIGNAL:FORM:AT:WIDTH``. A form is a shape of u = (signal - AT) / WIDTH, and what its
size acts on. With ``:SIGNAL:AT:WIDTH`` behind, the size grows with a second signal.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from monitor.base.counts import plain
from monitor.base.errors import ModelError
from training.greybox.effects import shape as shapes
from training.greybox.effects.air import SLOWLY
from training.greybox.effects.effect import Changed, Effect, Parameter, Place, Values
from training.greybox.quantity.value import Quantity, maximum

PREFIX: Final = "empirical"
PERCENT: Final = 100.0


@dataclass(frozen=True, slots=True)
class Target:
    """What the size of an effect acts on."""

    unit: str
    most: float  # in either direction
    changed: Callable[[Place, Quantity, Values], Changed]
    parameters: tuple[Parameter, ...] = ()  # of its own, after those of the shape
    needs: tuple[str, ...] = ()


def _mixture(place: Place, percent: Quantity, own: Values) -> Changed:
    factor = maximum(1.0 + percent * (1.0 / PERCENT), 0.0)
    return {"factor": place.of("factor") * factor}


def _fuel(place: Place, mg: Quantity, own: Values) -> Changed:
    return {"fuel_mg": maximum(place.of("fuel_mg") + mg, 0.0)}


def _vapour(place: Place, mg_per_s: Quantity, own: Values) -> Changed:
    return _fuel(place, mg_per_s / place.strokes_per_s(), own)


def _air(place: Place, percent: Quantity, own: Values) -> Changed:
    """Change the cylinder's air, of which an ECU with an air meter learns a share over seconds."""
    learned, followed_s = own
    change = percent * (1.0 / PERCENT)
    known = place.lag(change + 1.0, followed_s) - 1.0
    return place.air_times((1.0 + change) / (1.0 + learned * known))


MIXTURE: Final = Target("%", 40.0, _mixture)
FUEL: Final = Target("mg/stroke", 8.0, _fuel)
VAPOUR: Final = Target("mg/s", 200.0, _vapour, needs=("engine_speed_rpm",))
_LEARNED: Final = (
    Parameter("learned", "-", 0.0, 1.0, (0.5,), spread=0.5),
    replace(SLOWLY, spread=2.0),
)
AIR: Final = Target("%", 40.0, _air, _LEARNED)
GROWTH: Final = Parameter("growth", "", -4.0, 4.0, (0.1,))  # of the size, per u of a second signal
FORMS: Final[Mapping[str, tuple[Target, shapes.Shape]]] = {
    "factor": (MIXTURE, shapes.LINE),
    "mass": (FUEL, shapes.LINE),
    "vapour": (VAPOUR, shapes.LINE),
    "slow": (MIXTURE, shapes.LATE_LINE),
    "bump": (AIR, shapes.BUMP),
    "step": (AIR, shapes.STEP),
    "curve": (MIXTURE, shapes.CURVE),
    "bend": (MIXTURE, shapes.BEND),
    "exponential": (MIXTURE, shapes.EXPONENTIAL),
}

NUMBER: Final = r"(-?\d+\.?\d*(?:e[-+]\d+)?)"
NAME: Final = re.compile(  # a column of a log may have a colon in its name
    f"{PREFIX}:(.+):({'|'.join(FORMS)}):{NUMBER}:{NUMBER}(?::(.+):{NUMBER}:{NUMBER})?"
)


def is_empirical(name: str) -> bool:
    """Return whether the name is one of an empirical effect."""
    return name.startswith(f"{PREFIX}:")


def name_of(signal: str, form: str, at: float, width: float) -> str:
    """Return the effect's name.

    >>> name_of("manifold_temperature_degc", "factor", 30.0, 20.0)
    'empirical:manifold_temperature_degc:factor:30:20'
    """
    return f"{PREFIX}:{signal}:{form}:{at:.6g}:{width:.6g}"


def growing(name: str, signal: str, at: float, width: float) -> str:
    """Return the name of the effect whose size grows with a second signal."""
    return f"{name}:{signal}:{at:.6g}:{width:.6g}"


class NameParts(NamedTuple):
    """What the name of an empirical effect says."""

    over: shapes.ScaledSignal
    form: str
    target: Target
    shape: shapes.Shape
    growth: shapes.ScaledSignal | None


def parts_of(name: str) -> NameParts:
    """Return what a name says; raises ModelError if it is none of an empirical effect."""
    said = NAME.fullmatch(name)
    if said is None:
        raise ModelError(f"{name!r} is no empirical effect")
    signal, form, at, width, *second = said.groups()
    over = shapes.ScaledSignal(signal, float(at), float(width))
    growth = shapes.ScaledSignal(second[0], *map(float, second[1:])) if second[0] else None
    return NameParts(over, form, *FORMS[form], growth)


def effect_of(name: str) -> Effect:
    """Return the effect that a name says; raises ModelError if it says none."""
    over, _, target, shape, growth = parts_of(name)
    parameters = shape.parameters(target.unit, target.most)
    n = len(parameters)

    def equation(place: Place, values: Values) -> Changed:
        size, own = shape.size(place, over.u(place), values[:n]), values[n:]
        if growth is not None:
            grown, *own = own
            size = size * (1.0 + grown * growth.u(place))
        return target.changed(place, size, own)

    signals = (over.signal, *((growth.signal,) if growth else ()), *target.needs)
    return Effect(
        name=name,
        says=f"the mixture goes with {over.signal.replace('_', ' ')}",
        parameters=(*parameters, *((GROWTH,) if growth else ()), *target.parameters),
        needs=tuple(dict.fromkeys(signals)),
        tag="physics",
        source="found in the recordings",
        equation=equation,
    )


def formula(name: str, values: Values) -> str:
    """Return the effect with its constants as a formula.

    >>> formula("empirical:manifold_temperature_degc:factor:30:20", [0.4, -1.76])
    'mixture × (1 + 0.4 % - 0.088 % per unit of (manifold_temperature_degc - 30))'
    """
    over, _, target, shape, growth = parts_of(name)
    own = len(values) - len(target.parameters)
    n = own - (growth is not None)
    size = shape.says(values[:n], over, target.unit)
    if growth:
        by = plain(values[n] / growth.width, 3, "+")
        size = f"+ ({size}) × (1 {by} per unit of ({growth.signal} - {plain(growth.at, 6)}))"
    if target is MIXTURE:
        return f"mixture × (1 {size})"
    if target is AIR:
        learned, followed_s = values[own:]
        return (
            f"air × (1 {size}), of which the ECU learns {learned:.0%} in {plain(followed_s, 2)} s"
        )
    return f"fuel {size}"
