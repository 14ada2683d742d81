"""The library of effects that a vehicle may have and its model may lack, one file per effect.

Each effect has a few constants and changes the mixture's path (``training.greybox.chain.Path``),
nothing else. Its equation stands once in its file; a drive and a graph compute it alike. For a new
effect write the file and enter it here; fits try the effects in this order. A distribution may
bring effects of its own, see ``brought``.

``ALL`` and ``LIBRARY`` are made on first use, because a module that brings an effect imports this
package.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from training.greybox.effects.air import (
    charge_temperature,
    maf_offset,
    maf_pulsation,
    manifold_filling,
    scavenging,
)
from training.greybox.effects.brought import with_brought
from training.greybox.effects.exhaust import (
    back_pressure,
    delay_flow,
    exhaust_leak,
    mix_flow,
    sensor_asymmetry,
)
from training.greybox.effects.form.effect import Effect, Own, Parameter, along
from training.greybox.effects.fuel import (
    ethanol,
    fuel_cut_tail,
    injector_offset,
    purge,
    rail_exponent,
    wall_film,
)

ALL: tuple[Effect, ...]
LIBRARY: Mapping[str, Effect]
OWN: Final[tuple[Effect, ...]] = (  # of this package
    wall_film.EFFECT,
    injector_offset.EFFECT,
    rail_exponent.EFFECT,
    purge.EFFECT,
    ethanol.EFFECT,
    maf_offset.EFFECT,
    maf_pulsation.EFFECT,
    scavenging.EFFECT,
    charge_temperature.EFFECT,
    manifold_filling.EFFECT,
    delay_flow.EFFECT,
    mix_flow.EFFECT,
    exhaust_leak.EFFECT,
    fuel_cut_tail.EFFECT,
    sensor_asymmetry.EFFECT,
    back_pressure.EFFECT,
)


def __getattr__(name: str) -> object:
    if name not in ("ALL", "LIBRARY"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    every = with_brought(OWN)
    library = MappingProxyType({effect.name: effect for effect in every})
    globals().update(ALL=every, LIBRARY=library)
    return globals()[name]


__all__ = ["ALL", "LIBRARY", "OWN", "Effect", "Own", "Parameter", "along"]
