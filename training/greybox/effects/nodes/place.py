"""Where an effect acts in a graph: the path, the signals and what the effect remembers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from training.greybox.chain import MG_RPM_PER_KG_H
from training.greybox.effects.effect import FLOW_MIN_KG_H, STANDARD_KPA
from training.greybox.effects.nodes.value import Value, clip, exp, maximum, where
from training.greybox.graph.nodes import Nodes, with_fields
from training.narx.export import Graph

LEAST_S = 1e-6  # of a lag, as in ``effects.dynamics``
LEAST_SAMPLES = 1e-9  # of a lag that may be far below the sample period


@dataclass(slots=True)
class Place:
    """The graph as one effect sees it; its states are used up in the order of the calls.

    Whatever starts settled at its first input does so when ``begun``, the first state, is 0, as
    after a reset: the state then takes its input for what had always been there.
    """

    graph: Graph
    nodes: Nodes
    signals: Mapping[str, str]
    states: Sequence[str]
    period_s: float
    kept: list[str] = field(default_factory=list, init=False)  # the next states
    _read: int = field(default=0, init=False)
    _begun: Value | None = field(default=None, init=False)

    def of(self, name: str) -> Value:
        """Return a field of the path."""
        return Value(self.graph, getattr(self.nodes, name))

    def signal(self, name: str) -> Value:
        """Return a signal that must be there."""
        return Value(self.graph, self.signals[name])

    def injecting(self) -> Value:
        """Return where fuel is injected, as ``effects.effect.injecting``."""
        return self.signal("fuel_mass_mg") > 0.0

    def changed(self, **fields: Value) -> Nodes:
        """Return the path with some fields changed."""
        return with_fields(self.nodes, **{name: value.name for name, value in fields.items()})

    def flow_kg_h(self) -> Value:
        """Return the exhaust's mass flow, as ``effects.effect.flow_kg_h``."""
        flow = self.of("air_mg") * self.signal("engine_speed_rpm") * (1.0 / MG_RPM_PER_KG_H)
        return maximum(flow, FLOW_MIN_KG_H)

    def ambient_kpa(self, without: float = STANDARD_KPA) -> Value | float:
        """Return ambient pressure, the given one where it is not measured."""
        measured = "ambient_pressure_kpa" in self.signals
        return self.signal("ambient_pressure_kpa") if measured else without

    def lag(self, u: Value, time_s: Value | float) -> Value:
        """Return ``u`` through a first-order lag, as ``effects.dynamics.lag``."""
        x = self._settled(u)
        if isinstance(time_s, Value):
            share = 1.0 - exp(-self.period_s / maximum(time_s, LEAST_S))
            return self._keep(x + share * (u - x))
        return self._keep(x + _share(time_s, self.period_s) * (u - x))

    def ramp_lag_in_proportion(self, u: Value, time_s: Value) -> Value:
        """Return a positive ``u`` of which ``effects.dynamics.ramp_lag`` makes the logarithm."""
        x, last = self._settled(u), self._settled(u)
        time = maximum(time_s / self.period_s, LEAST_SAMPLES)
        drop = 1.0 - exp(-1.0 / time)
        newest = 1.0 - time * drop
        late = self._keep(x * (last / x) ** drop * (u / last) ** newest)
        self._keep(u)
        return late

    def _settled(self, u: Value) -> Value:
        """Return the next state, ``u`` itself at the beginning."""
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
