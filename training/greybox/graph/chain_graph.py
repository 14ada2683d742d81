"""The grey-box chain as the ONNX graph ``step``.

State: the reading (phi, so that the monitor can force it), the shift register of phi at the valve,
newest first, the states of the lags, those of the charge's error, and last those of the effects.
All nodes work element by element, and the one sum has at most two terms that are not zero: single
and batched runs give the same bits. Constants and names follow ``chain``; change both together.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard, StateLayout
from monitor.model.step import LAMBDA_MAX, PHI_MAX
from training.greybox.chain import SPEED_LEAST_RPM, Constants, base_path, with_speed
from training.greybox.chain import Path as ChainPath
from training.greybox.charge.error import ChargeError
from training.greybox.charge.map import ChargeMap
from training.greybox.effects import along
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.graph.effect import GraphEffect, effects_nodes, graph_effect
from training.greybox.graph.nodes import (
    base_nodes,
    charge_error_nodes,
    charge_nodes,
    lag_nodes,
    lag_weights,
    late_nodes,
    pumped_nodes,
    sensor_weights,
    speed_nodes,
    valve_nodes,
)
from training.narx.export import Graph, finished, write

FORGOTTEN = 12.0  # time constants after which the start of a lag no longer matters


@dataclass(frozen=True, slots=True, kw_only=True)
class Greybox:
    """A chain with its charge and effects, as the graph contains it."""

    constants: Constants
    inputs: tuple[str, ...]  # of the chain and of effects
    u_low: FloatArray  # (n_inputs,), inputs are clipped to this range first
    u_high: FloatArray
    period_s: float
    register: int  # samples of phi at the valve in the state
    charge_map: ChargeMap | None = None  # None: the charge is an input
    effects: tuple[GraphEffect, ...] = ()
    charge_error: ChargeError | None = None  # of a charge that is an input
    own: tuple[ModelEffect, ...] = ()  # of the healthy vehicle, before the effects

    @classmethod
    def of(cls, card: ModelCard) -> "Greybox":
        """Return the chain of a model's card.

        Raises ModelError if the card is not of a grey-box model.
        """
        if card.kind != "greybox":
            raise ModelError(f"a {card.kind} model, a greybox is wanted")
        try:
            given = card.structure
            constants = Constants(**{n: c["value"] for n, c in given["constants"].items()})
            low, high = (np.array(given[name]) for name in ("inputs_low", "inputs_high"))
            register = int(given["register_samples"])
            entry = given["charge_map"]
            charge_map = None if entry is None else ChargeMap.from_card(entry)
            entry = given.get("charge_error")
            charge_error = None if entry is None else ChargeError.from_card(entry)
            own = tuple(
                ModelEffect.with_values(name, values)
                for name, values in given.get("own", {}).items()
            )
            period_s = card.period_ns / 1e9
            effects = tuple(
                graph_effect(ModelEffect.from_card(entry), period_s, entry["reads"])
                for entry in card.effects
            )
        except (KeyError, TypeError) as error:
            raise ModelError(
                f"the card of a greybox lacks part of its structure: {error}"
            ) from None
        return cls(
            constants=constants,
            inputs=card.input_names,
            u_low=low,
            u_high=high,
            period_s=period_s,
            register=register,
            charge_map=charge_map,
            effects=effects,
            charge_error=charge_error,
            own=own,
        )

    def structure(self) -> dict[str, Any]:
        """Return the structure for a card, without the constants."""
        return {
            "register_samples": self.register,
            "charge_map": None if self.charge_map is None else self.charge_map.to_card(),
            "charge_error": None if self.charge_error is None else self.charge_error.to_card(),
            "own": {each.name: each.values.tolist() for each in self.own},
            "inputs_low": self.u_low.tolist(),
            "inputs_high": self.u_high.tolist(),
        }

    @property
    def state_layout(self) -> StateLayout:
        """Size of the state; the reading comes first."""
        return StateLayout(self.chain_states + sum(e.n_states for e in self.on_the_way), 0, 1, 1)

    @property
    def on_the_way(self) -> tuple[GraphEffect, ...]:
        """The healthy vehicle's own effects, then the added ones."""
        own = (graph_effect(e, self.period_s, e.effect.signals_of(self.inputs)) for e in self.own)
        return (*own, *self.effects)

    @property
    def chain_states(self) -> int:
        """Number of states before those of the effects."""
        return 4 + self.register + (0 if self.charge_error is None else 2)

    @property
    def memory(self) -> int:
        """Samples after which a steady input has filled the register and all lags."""
        lags_s = self.constants.mixing_s + self.constants.sensor_s
        for effect in self.on_the_way:
            lags_s = lags_s * (1.0 + effect.slower) + effect.lag_s
        return self.register + math.ceil(FORGOTTEN * lags_s / self.period_s)

    def signals(self, u: FloatArray) -> dict[str, FloatArray]:
        """Return the signals (n,) of ``u`` (n, n_inputs) as the graph sees them.

        The inputs are clipped. Engine speed is computed if it is no input; ``air_mass_mg`` comes
        from the charge map or is corrected by the charge's error, if the chain has one.
        """
        limited = np.clip(u, self.u_low, self.u_high)
        signals = {name: limited[:, i] for i, name in enumerate(self.inputs)}
        if self.charge_map is not None:
            signals["air_mass_mg"] = self.charge_map.air_mass_mg(signals)
        signals = with_speed(signals)
        if self.charge_error is not None:
            signals["air_mass_mg"] = self.charge_error.air_mass_mg(signals, self.period_s)
        return signals

    def path(self, signals: Mapping[str, FloatArray]) -> ChainPath:
        """Return the path of the healthy vehicle, without added effects, for these ``signals``."""
        own = tuple((each.effect, each.values) for each in self.own)
        return along(base_path(self.constants, signals), own, signals, self.period_s)


def register_for(longest_s: float, period_s: float) -> int:
    """Return the samples that a register for a dead time of ``longest_s`` holds.

    >>> register_for(0.25, 0.1)
    3
    """
    return max(math.ceil(longest_s / period_s), 1)


def longest_dead_time_s(constants: Constants, inputs: Sequence[str], u_low: FloatArray) -> float:
    """Return the chain's dead time at the lowest engine speed in the range of the inputs.

    >>> longest_dead_time_s(Constants(dead_time_s=0.1, dead_time_revolutions=2.0),
    ...                     ["engine_speed_rpm"], np.array([480.0]))
    0.35
    """
    lowest = dict(zip(inputs, u_low.tolist(), strict=True))
    slowest_rpm = max(lowest.get("engine_speed_rpm", SPEED_LEAST_RPM), SPEED_LEAST_RPM)
    return float(constants.dead_time_s + constants.dead_time_revolutions * 60.0 / slowest_rpm)


def build(greybox: Greybox) -> ModelProto:
    """Return the graph ``step``, float32, without a card."""
    graph = Graph()
    limits = [
        graph.constant("u_low", greybox.u_low[None]),
        graph.constant("u_high", greybox.u_high[None]),
    ]
    raised = graph.add("Max", ["u", limits[0]], "u_raised")
    clipped = graph.add("Min", [raised, limits[1]], "u_clipped")
    signals = {
        name: graph.take(clipped, i, i + 1, f"signal_{name}")
        for i, name in enumerate(greybox.inputs)
    }
    phi, parts = chain_nodes(graph, greybox, signals, "state")
    least = graph.constant("phi_least", 1.0 / LAMBDA_MAX)
    graph.add("Reciprocal", [graph.add("Max", [phi, least], "phi_readable")], "lambda_hat")
    graph.add("Concat", parts, "next_state", axis=1)
    return finished(graph, len(greybox.inputs), greybox.state_layout.size)


def chain_nodes(
    graph: Graph, greybox: Greybox, signals: Mapping[str, str], state: str
) -> tuple[str, list[str]]:
    """Add the chain with its effects; return the reading phi and the parts of its next state.

    signals : clipped inputs by name; state : (batch, n) as in ``state_layout``
    Two chains in one graph need a ``graph.part`` each.
    """
    signals, register = dict(signals), greybox.register
    if greybox.charge_map is not None:
        signals["air_mass_mg"] = charge_nodes(graph, greybox.charge_map, signals)
    if "engine_speed_rpm" not in signals:
        signals["engine_speed_rpm"] = speed_nodes(graph, signals)
    kept = list[str]()
    if greybox.charge_error is not None:
        begun, held = (
            graph.take(state, i, i + 1, f"charge_state{i}") for i in (4 + register, 5 + register)
        )
        signals["air_mass_mg"], kept = charge_error_nodes(
            graph, greybox.charge_error, signals, (begun, held), greybox.period_s
        )
    nodes = base_nodes(graph, greybox.constants, signals)
    nodes, after = effects_nodes(
        graph,
        greybox.on_the_way,
        path=nodes,
        signals=signals,
        state=state,
        first=greybox.chain_states,
    )
    kept = [*kept, *after]
    valve = valve_nodes(graph, nodes)
    places = {"read": 0, "late": 1 + register, "mixed": 2 + register, "pumped": 3 + register}
    old = {name: graph.take(state, i, i + 1, f"old_{name}") for name, i in places.items()}
    past = graph.take(state, 1, 1 + register, "past")
    history = graph.add("Concat", [valve, past], "history", axis=1)
    late = late_nodes(graph, history, nodes.dead_time_s, register, greybox.period_s)
    weights = lag_weights(graph, nodes.mixing_s, "mixing", greybox.period_s)
    mixed = lag_nodes(
        graph, "mixed", state=old["mixed"], new=late, last=old["late"], weights=weights
    )
    pumped = pumped_nodes(graph, nodes, mixed)
    weights = sensor_weights(graph, nodes, pumped, old["read"], greybox.period_s)
    read = lag_nodes(
        graph, "read", state=old["read"], new=pumped, last=old["pumped"], weights=weights
    )
    limits = [graph.constant("phi_low", 0.0), graph.constant("phi_high", PHI_MAX)]
    phi = graph.add("Clip", [read, *limits], "phi")
    rest = graph.take(history, 0, register, "next_register")
    return phi, [phi, rest, late, mixed, pumped, *kept]


def save(path: Path | str, greybox: Greybox, card: ModelCard) -> None:
    """Write graph and card to one file."""
    write(path, build(greybox), card)
