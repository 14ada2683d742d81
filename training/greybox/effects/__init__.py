"""The library of effects that a vehicle may have and its model may lack, by where it acts.

Each effect has a few constants and changes the mixture's path (``training.greybox.chain.Path``),
nothing else. Its equation stands once; a drive and a graph compute it alike. Fits try
the effects in the order of the modules.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from training.greybox.effects import air, exhaust, fuel
from training.greybox.effects.effect import Effect, Parameter

LIBRARY: Final[Mapping[str, Effect]] = MappingProxyType(
    {
        each.name: each
        for module in (fuel, air, exhaust)
        for each in vars(module).values()
        if isinstance(each, Effect)
    }
)

__all__ = ["LIBRARY", "Effect", "Parameter"]
