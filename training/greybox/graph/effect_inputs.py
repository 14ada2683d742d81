"""The inputs of a model with effects: the signals that the effects read, and their ranges."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.signals import BY_NAME, unit_of
from monitor.model.card import Channel
from training.greybox.chain import AIR_LEAST_MG, SPEED_LEAST_RPM
from training.greybox.effects.model_effect import FUEL, ModelEffect
from training.recordings.samples.scaling import MARGIN

Ranges = Mapping[str, tuple[float, float]]  # low and high of each signal in the drives of a fit
SPEED = "engine_speed_rpm"
LEAST = {"air_mass_mg": AIR_LEAST_MG, "engine_speed_rpm": SPEED_LEAST_RPM, "fuel_mass_mg": 0.0}
SURROUNDINGS = "context"  # role of signals that change between drives and hardly within one


def seeing(added: ModelEffect, inputs: Sequence[str], ranges: Ranges) -> ModelEffect:
    """Return an effect that reads the present signals; raises ModelError if it lacks one."""
    # a chain works out the speed if it is no input
    check_there(f"effect {added.name}", added.effect.needs, {*inputs, *ranges, SPEED})
    return replace(added, reads=added.effect.signals_of(ranges))


def check_there(reader: str, wanted: Iterable[str], available: Collection[str]) -> None:
    """Raise ModelError if a signal that a chain or an effect reads is not available."""
    if missing := [name for name in wanted if name not in available]:
        raise ModelError(
            f"{reader} needs {', '.join(missing)}: neither an input of the model nor in the "
            "drives of the fit"
        )


def limits_of(inputs: Iterable[str], old: Ranges, seen: Ranges) -> Ranges:
    """Return the range to clip to of each input, at most one of the two may lack it.

    It is that of the base and, with a margin, what the fit has seen.
    """
    limits = {}
    for name in inputs:
        ranges = [old[name]] if name in old else []
        if name in seen:
            ranges.append(with_margin(name, *_used(name, name not in old, seen[name])))
        lows, highs = zip(*ranges, strict=True)
        limits[name] = min(lows), max(highs)
    return from_fuel_cut(limits)


def from_fuel_cut(limits: Ranges) -> Ranges:
    """Return ranges that begin at no fuel: a cut must reach the chain, whether trained or not."""
    return {**limits, FUEL: (0.0, limits[FUEL][1])}


def with_margin(name: str, low: float, high: float) -> tuple[float, float]:
    """Return the range to clip to for one that was seen, within what is possible."""
    margin = MARGIN["phi"] * (high - low)
    return max(low - margin, LEAST.get(name, -np.inf)), high + margin


def channel_of(name: str, old: Channel | None, seen: tuple[float, float] | None) -> Channel:
    """Return an input for the card; at most one of ``old`` and ``seen`` may be None."""
    if seen is None:
        assert old is not None
        return old
    low, high = _used(name, old is None, seen)
    if old is None:
        return Channel(
            name=name,
            unit=unit_of(name),
            minimum=low,
            maximum=high,
            percentile_0_1=float(seen[0]),
            percentile_99_9=float(seen[1]),
        )
    return replace(old, minimum=min(old.minimum, low), maximum=max(old.maximum, high))


def _used(name: str, new: bool, seen: tuple[float, float]) -> tuple[float, float]:
    """Return the range in which an input is used: that of the fit, or all plausible values.

    A few drives hold hardly more than one altitude and weather, but the form of an effect holds in
    all of them: the monitor must not stop judging because of an input that only effects read.
    """
    signal = BY_NAME.get(name)
    if signal is None or not (new or signal.role == SURROUNDINGS):
        return float(seen[0]), float(seen[1])
    return min(signal.minimum, float(seen[0])), max(signal.maximum, float(seen[1]))
