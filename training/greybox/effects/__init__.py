"""The library of effects that a vehicle may have and its model may lack, by where it acts.

Each effect has a few constants and changes the mixture's path (``training.greybox.chain.Path``),
nothing else. Its equation stands once; a drive and a graph compute it alike. Fits try
the effects in the order of the modules. A distribution may bring further ones by the entry point
``o2_monitor.effects``, named as the effect; they follow in alphabetical order.

``LIBRARY`` is made on first use, because a module that brings an effect imports this package.
"""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Final

from monitor.base.errors import UsageError
from monitor.base.foreign import ForeignError, returned
from training.greybox.effects import air, exhaust, fuel
from training.greybox.effects.effect import Effect, Parameter

GROUP: Final = "o2_monitor.effects"
LIBRARY: Mapping[str, Effect]


def __getattr__(name: str) -> object:
    if name != "LIBRARY":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    own = (each for module in (fuel, air, exhaust) for each in vars(module).values())
    library = {each.name: each for each in own if isinstance(each, Effect)}
    for plugin in sorted(entry_points(group=GROUP), key=lambda each: each.name):
        found = _loaded(plugin)
        if found.name in library:
            raise UsageError(f"effect {found.name}: a plug-in brings it, but the name is taken")
        library[found.name] = found
    return globals().setdefault(name, MappingProxyType(library))


def origins() -> dict[str, str]:
    """Return of every effect that was brought its distribution with the version."""
    return {
        each.name: f"{each.dist.name} {each.dist.version}" if each.dist else each.value
        for each in entry_points(group=GROUP)
    }


def _loaded(plugin: EntryPoint) -> Effect:
    try:
        found = returned(f"the effect {plugin.value}", plugin.load, Effect)
    except ForeignError as error:
        raise UsageError(str(error)) from error
    if found.name != plugin.name:
        raise UsageError(
            f"the effect {plugin.value} is called {found.name}, its entry point {plugin.name}"
        )
    return found


__all__ = ["LIBRARY", "Effect", "Parameter", "origins"]
