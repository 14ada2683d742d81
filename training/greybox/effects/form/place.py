"""The place of an effect: the path and the signals, as arrays or as tensors of a graph.

An effect is written once, in terms of a ``Place``. ``ArrayPlace`` computes it for a drive,
``GraphPlace`` adds its nodes to a graph.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import MG_RPM_PER_KG_H, Path
from training.greybox.effects.form import dynamics
from training.greybox.effects.form.dynamics import LEAST_S, LEAST_SAMPLES
from training.greybox.effects.form.quantities import (
    AIR_FACTOR_MAX,
    AIR_FACTOR_MIN,
    FLOW_MIN_KG_H,
    KG_PER_H_AND_LITRE_PER_S,
    SPEED_MIN_RPM,
    STANDARD_KPA,
    Signals,
)
from training.greybox.effects.form.value import Quantity, Value, clip, exp, maximum, where

if TYPE_CHECKING:
    from training.narx.export import Graph


@dataclass(frozen=True, slots=True, kw_only=True)
class PathNodes:
    """``chain.Path`` in a graph: each field is the name of a (batch, 1) or scalar tensor."""

    fuel_mg: str
    air_mg: str
    factor: str
    dead_time_s: str
    mixing_s: str
    sensor_rising_s: str
    sensor_falling_s: str
    gas_factor: str
    span: str


class Place(ABC):
    """The surroundings of an effect; each lag starts settled at its first input."""

    signals: Mapping[str, Any]
    period_s: float

    @abstractmethod
    def of(self, name: str) -> Quantity:
        """Return a field of the path."""

    @abstractmethod
    def signal(self, name: str) -> Quantity:
        """Return a signal that must be present."""

    @abstractmethod
    def lag(self, u: Quantity, time_s: Quantity) -> Quantity:
        """Return ``u`` behind a first-order lag, see ``dynamics.lag``."""

    @abstractmethod
    def ramp_lag_in_proportion(self, u: Quantity, time_s: Quantity) -> Quantity:
        """Return a positive ``u`` whose logarithm is behind ``dynamics.ramp_lag``."""

    def injecting(self) -> Quantity:
        """Return whether fuel is injected; in a fuel cut, fuel from the walls may still enter."""
        return self.signal("fuel_mass_mg") > 0.0

    def strokes_per_s(self) -> Quantity:
        """Return the intake strokes of all four cylinders per second."""
        return maximum(self.signal("engine_speed_rpm"), SPEED_MIN_RPM) / 30.0

    def ambient_kpa(self, without: float = STANDARD_KPA) -> Quantity:
        """Return the ambient pressure, or ``without`` if it is not measured."""
        measured = "ambient_pressure_kpa" in self.signals
        return self.signal("ambient_pressure_kpa") if measured else without

    def flow_kg_h(self) -> Quantity:
        """Return the exhaust's mass flow from charge and engine speed."""
        flow = self.of("air_mg") * self.signal("engine_speed_rpm") * (1.0 / MG_RPM_PER_KG_H)
        return maximum(flow, FLOW_MIN_KG_H)

    def passage_s(self, litres: float) -> Quantity:
        """Return the time in s in which the exhaust passes through a volume."""
        return litres * KG_PER_H_AND_LITRE_PER_S / self.flow_kg_h()

    def air_times(self, factor: Quantity) -> dict[str, Quantity]:
        """Return the change of the cylinder's air by a factor, limited to 0.5 .. 2."""
        return {"air_mg": self.of("air_mg") * clip(factor, AIR_FACTOR_MIN, AIR_FACTOR_MAX)}


@dataclass(frozen=True, slots=True)
class ArrayPlace(Place):
    """A drive as one effect sees it, all quantities (n,)."""

    path: Path
    signals: Signals
    period_s: float

    def of(self, name: str) -> FloatArray:
        """Return a field of the path (n,)."""
        values: FloatArray = getattr(self.path, name)
        return values

    def signal(self, name: str) -> FloatArray:
        """Return a signal (n,)."""
        return self.signals[name]

    def lag(self, u: FloatArray, time_s: FloatArray | float) -> FloatArray:
        """Return ``dynamics.lag``."""
        return dynamics.lag(u, time_s, self.period_s)

    def ramp_lag_in_proportion(self, u: FloatArray, time_s: FloatArray) -> FloatArray:
        """Return ``dynamics.ramp_lag`` of the logarithm of ``u``, its power of e."""
        return np.exp(dynamics.ramp_lag(np.log(u), time_s, self.period_s))


@dataclass(slots=True)
class GraphPlace(Place):
    """A graph as one effect sees it; the calls use up its states in their order.

    After a reset all states are 0; ``begun``, the first of them, tells this first step from the
    later ones.
    """

    graph: "Graph"
    path: PathNodes
    signals: Mapping[str, str]  # tensor of each signal, (batch, 1)
    states: Sequence[str]
    period_s: float
    kept: list[str] = field(default_factory=list, init=False)  # the next states
    _read: int = field(default=0, init=False)
    _begun: Value | None = field(default=None, init=False)

    def of(self, name: str) -> Value:
        """Return a field of the path."""
        return Value(self.graph, getattr(self.path, name))

    def signal(self, name: str) -> Value:
        """Return a signal."""
        return Value(self.graph, self.signals[name])

    def lag(self, u: Value, time_s: Value | float) -> Value:
        """Add ``dynamics.lag``."""
        x = self._settled(u)
        if isinstance(time_s, Value):
            share = 1.0 - exp(-self.period_s / maximum(time_s, LEAST_S))
            return self._keep(x + share * (u - x))
        return self._keep(x + _share(time_s, self.period_s) * (u - x))

    def ramp_lag_in_proportion(self, u: Value, time_s: Value) -> Value:
        """Add ``dynamics.ramp_lag`` of the logarithm of ``u``, in powers: see ``value``."""
        x, last = self._settled(u), self._settled(u)
        time = maximum(time_s / self.period_s, LEAST_SAMPLES)
        drop = 1.0 - exp(-1.0 / time)
        newest = 1.0 - time * drop
        late = self._keep(x * (last / x) ** drop * (u / last) ** newest)
        self._keep(u)
        return late

    def _settled(self, u: Value) -> Value:
        """Return the effect's next state, or ``u`` in the first step."""
        if self._begun is None:
            self._begun = self._state() > 0.5
            self._keep(clip(u, 1.0, 1.0))
        return where(self._begun, self._state(), u)

    def _state(self) -> Value:
        self._read += 1
        return Value(self.graph, self.states[self._read - 1])

    def _keep(self, value: Value) -> Value:
        self.kept.append(value.name)
        return value


def _share(time_s: float, period_s: float) -> float:
    return 1.0 - math.exp(-period_s / max(time_s, LEAST_S))
