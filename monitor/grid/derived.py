"""Derived signals, which no message carries and others give, such as fuel per stroke."""

from collections.abc import Sequence

import numpy as np

from monitor.base.errors import SignalMapError
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, Quality, QualityArray
from monitor.decode.signal_map import Derived

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
        columns = [places.get(name, 0) for name in names]  # anything for a derived one
        self._columns = np.array(columns, dtype=np.intp)
        self._derived = [
            (i, recipes[name], [places[source] for source in recipes[name].sources])
            for i, name in enumerate(names)
            if name in recipes
        ]

    def of(self, values: FloatArray, quality: QualityArray) -> tuple[FloatArray, QualityArray]:
        """Return values and quality of many samples, shape (n, n_names), NaN where not good.

        values, quality : shape (n, n_channels)
        """
        out, out_quality = values.take(self._columns, axis=1), quality.take(self._columns, axis=1)
        for i, recipe, channels in self._derived:
            out[:, i], out_quality[:, i] = derive(
                recipe, [values[:, channel] for channel in channels]
            )
            worst = quality[:, channels].max(axis=1)
            bad = worst > _GOOD
            out[bad, i], out_quality[bad, i] = np.nan, worst[bad]
        return out, out_quality


def derive(recipe: Derived, sources: Sequence[FloatArray]) -> tuple[FloatArray, QualityArray]:
    """Return derived values with their quality, shape (n,); a zero in the denominator is INVALID.

    sources : good values in the order of ``recipe.sources``
    """
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
    value[quality != _GOOD] = np.nan
    return value, quality
