"""Derived signals, which no message carries and others give, such as fuel per stroke."""

import math
from collections.abc import Sequence

import numpy as np

from monitor.base.errors import SignalMapError
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, Quality, QualityArray
from monitor.decode.signal_map import Derived

_NAN = math.nan
_GOOD, _INVALID, _OUT_OF_RANGE = (
    int(quality) for quality in (Quality.GOOD, Quality.INVALID, Quality.OUT_OF_RANGE)
)


class Output:
    """Picks a sample's values from those of the channels and makes the derived ones."""

    def __init__(
        self, channels: Sequence[str], names: Sequence[str], derived: Sequence[Derived]
    ) -> None:
        places = {name: place for place, name in enumerate(channels)}
        recipes = {each.name: each for each in derived}
        missing = [name for name in names if name not in places and name not in recipes]
        if missing:
            raise SignalMapError(f"no channel and no derived signal is named {missing[0]}")
        self._n = len(names)
        self._picked = [(i, places[name]) for i, name in enumerate(names) if name not in recipes]
        self._derived = [
            (i, recipes[name], [places[source] for source in recipes[name].sources])
            for i, name in enumerate(names)
            if name in recipes
        ]
        self._is_identity = self._picked == [(i, i) for i in range(len(channels))] and (
            not self._derived
        )

    def of(
        self, values: Sequence[float], quality: Sequence[int]
    ) -> tuple[FloatArray, QualityArray]:
        """Return values and quality of one sample, NaN where not good."""
        if self._is_identity:
            return np.array(values), np.frombuffer(bytearray(quality), dtype=np.uint8)
        out, out_quality = np.empty(self._n), np.empty(self._n, dtype=np.uint8)
        for i, channel in self._picked:
            out[i], out_quality[i] = values[channel], quality[channel]
        for i, recipe, channels in self._derived:
            worst = max(quality[channel] for channel in channels)
            value = _NAN
            if worst == _GOOD:
                value, worst = derive(recipe, [values[channel] for channel in channels])
            out[i], out_quality[i] = value, worst
        return out, out_quality

    def of_arrays(
        self, values: FloatArray, quality: QualityArray
    ) -> tuple[FloatArray, QualityArray]:
        """Return values and quality of many samples, shape (n, n_names), bit for bit as ``of``.

        values, quality : shape (n, n_channels)
        """
        n = len(values)
        out, out_quality = np.empty((n, self._n)), np.empty((n, self._n), dtype=np.uint8)
        for i, channel in self._picked:
            out[:, i], out_quality[:, i] = values[:, channel], quality[:, channel]
        for i, recipe, channels in self._derived:
            out[:, i], out_quality[:, i] = derive_arrays(
                recipe, [values[:, channel] for channel in channels]
            )
            worst = quality[:, channels].max(axis=1)
            bad = worst > _GOOD
            out[bad, i], out_quality[bad, i] = _NAN, worst[bad]
        return out, out_quality


def derive(recipe: Derived, sources: Sequence[float]) -> tuple[float, int]:
    """Return a derived value with its quality; a zero in the denominator makes it INVALID.

    sources : good values in the order of ``recipe.sources``
    """
    value = recipe.factor
    n = len(recipe.numerator)
    for source in sources[:n]:
        value *= source
    for source in sources[n:]:
        if source == 0.0:
            return _NAN, _INVALID
        value /= source
    low, high = plausible_range(recipe.name)
    if not low <= value <= high:
        return _NAN, _OUT_OF_RANGE
    return value, _GOOD


def derive_arrays(
    recipe: Derived, sources: Sequence[FloatArray]
) -> tuple[FloatArray, QualityArray]:
    """Return derived values with their quality, shape (n,), bit for bit as ``derive``."""
    value = np.full(len(sources[0]), recipe.factor)
    quality = np.zeros(len(value), dtype=np.uint8)
    n = len(recipe.numerator)
    with np.errstate(all="ignore"):
        for source in sources[:n]:
            value = value * source
        for source in sources[n:]:
            quality[source == 0.0] = _INVALID
            value = value / source
    low, high = plausible_range(recipe.name)
    plausible = (value >= low) & (value <= high)
    quality[~plausible & (quality == _GOOD)] = _OUT_OF_RANGE
    value[quality != _GOOD] = _NAN
    return value, quality
