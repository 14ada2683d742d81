"""The library of effects that a vehicle may have and its model may lack, by where it acts.

Each effect has a few constants and changes the mixture's path (``training.greybox.chain.Path``),
nothing else. Its equation stands once; a drive and a graph compute it alike. Enter a new effect
here; fits try the effects in this order. A distribution may
bring effects of its own, see ``brought``.

``ALL`` and ``LIBRARY`` are made on first use, because a module that brings an effect imports this
package.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from training.greybox.effects import air, exhaust, fuel
from training.greybox.effects.brought import with_brought
from training.greybox.effects.effect import Effect, Own, Parameter, along

ALL: tuple[Effect, ...]
LIBRARY: Mapping[str, Effect]
OWN: Final[tuple[Effect, ...]] = (  # of this package
    fuel.WALL_FILM,
    fuel.INJECTOR_OFFSET,
    fuel.RAIL_EXPONENT,
    fuel.PURGE,
    fuel.ETHANOL,
    air.MAF_OFFSET,
    air.MAF_PULSATION,
    air.SCAVENGING,
    air.CHARGE_TEMPERATURE,
    air.MANIFOLD_FILLING,
    exhaust.DELAY_FLOW,
    exhaust.MIX_FLOW,
    exhaust.EXHAUST_LEAK,
    exhaust.FUEL_CUT_TAIL,
    exhaust.SENSOR_ASYMMETRY,
    exhaust.BACK_PRESSURE,
)


def __getattr__(name: str) -> object:
    if name not in ("ALL", "LIBRARY"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    every = with_brought(OWN)
    library = MappingProxyType({effect.name: effect for effect in every})
    globals().update(ALL=every, LIBRARY=library)
    return globals()[name]


__all__ = ["ALL", "LIBRARY", "OWN", "Effect", "Own", "Parameter", "along"]
