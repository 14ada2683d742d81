"""The library of effects that a vehicle may have and its model may lack.

The forms are a few constants at the sample rate; every effect changes what happens to the mixture
on its way (``training.greybox.chain.Path``) and nothing else.
"""

from collections.abc import Mapping
from types import MappingProxyType

from training.greybox.effects import air, exhaust, fuel, sensor
from training.greybox.effects.effect import Effect, Own, Parameter, along

ALL: tuple[Effect, ...] = (*fuel.EFFECTS, *air.EFFECTS, *exhaust.EFFECTS, *sensor.EFFECTS)
LIBRARY: Mapping[str, Effect] = MappingProxyType({effect.name: effect for effect in ALL})

__all__ = ["ALL", "LIBRARY", "Effect", "Own", "Parameter", "along"]
