"""The library of effects that a vehicle may have and its model may lack, by where it acts.

Each effect has a few constants and changes the mixture's path (``training.greybox.chain.Path``),
nothing else. Its equation stands once; a drive and a graph compute it alike. Enter a new effect
here; fits try the effects in this order. A distribution may bring further ones by the entry point
``o2_monitor.effects``, named as the effect; they follow in alphabetical order.

``ALL`` and ``LIBRARY`` are made on first use, because a module that brings an effect imports this
package.
"""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Final

from monitor.base.errors import UsageError
from training.greybox.effects import air, exhaust, fuel
from training.greybox.effects.effect import Effect, Own, Parameter, along

GROUP: Final = "o2_monitor.effects"
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
    library = {effect.name: effect for effect in OWN}
    for plugin in sorted(entry_points(group=GROUP), key=lambda each: each.name):
        found = _loaded(plugin)
        if found.name in library:
            raise UsageError(f"effect {found.name}: a plug-in brings it, but the name is taken")
        library[found.name] = found
    globals().update(ALL=tuple(library.values()), LIBRARY=MappingProxyType(library))
    return globals()[name]


def origins() -> dict[str, str]:
    """Return of every effect that was brought its distribution with the version."""
    return {
        each.name: f"{each.dist.name} {each.dist.version}" if each.dist else each.value
        for each in entry_points(group=GROUP)
    }


def _loaded(plugin: EntryPoint) -> Effect:
    try:
        found = plugin.load()
    except Exception as error:  # of somebody else's code
        raise UsageError(f"the effect {plugin.value} fails: {error or type(error)}") from error
    if not isinstance(found, Effect):
        raise UsageError(f"the effect {plugin.value} is no Effect but {type(found).__name__}")
    if found.name != plugin.name:
        raise UsageError(
            f"the effect {plugin.value} is called {found.name}, its entry point {plugin.name}"
        )
    return found


__all__ = ["ALL", "LIBRARY", "OWN", "Effect", "Own", "Parameter", "along", "origins"]
