"""Effects that other distributions bring by the entry point ``o2_monitor.effects``.

The name of the entry point is the effect's name, its object an ``Effect``.
"""

from importlib.metadata import EntryPoint, entry_points
from typing import Final

from monitor.base.errors import UsageError
from training.greybox.effects.effect import Effect

GROUP: Final = "o2_monitor.effects"


def with_brought(own: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """Return the effects of this package and those brought, in alphabetical order.

    Raises UsageError naming the entry point if its object cannot be loaded, is no ``Effect``, or
    has a name that is taken.
    """
    found = [_loaded(each) for each in sorted(entry_points(group=GROUP), key=lambda e: e.name)]
    names = [effect.name for effect in own]
    for effect in found:
        if effect.name in names:
            raise UsageError(f"effect {effect.name}: a plug-in brings it, but the name is taken")
        names.append(effect.name)
    return (*own, *found)


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
