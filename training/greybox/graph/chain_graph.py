"""The grey-box chain as the ONNX graph ``step``: its equations, traced.

State: the reading (phi, so that the monitor can force it), the mark of a trace, what charge and
effects keep, and last what the chain does: the register of phi at the valve, newest first, and the
inputs and states of its lags. All nodes work element by element, and each sum has at most two terms
that are not zero: single and batched runs give the same bits.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import starmap
from typing import Any, Self

import numpy as np
from onnx import ModelProto

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard, StateLayout
from monitor.model.step import LAMBDA_MAX, PHI_MAX
from training.greybox.chain import (
    AIR_LEAST_MG,
    SPEED_LEAST_RPM,
    Constants,
    base_path,
    simulate,
    with_speed,
)
from training.greybox.chain import Path as ChainPath
from training.greybox.charge import KINDS, Charge
from training.greybox.effects.model_effect import Effects, ModelEffect, along
from training.greybox.graph.effect_inputs import Ranges
from training.greybox.quantity.dynamics import ramp_lag, sensor_lag
from training.greybox.quantity.value import Quantity, StepTrace, Value, clip, maximum
from training.narx.export import Graph, finished
from training.narx.search.stability import CONTRACTION_LIMIT, CONTRACTION_SAMPLES, Contraction

AIR_MG = (AIR_LEAST_MG, 1e4)  # beyond what any cylinder takes
FORGOTTEN = 12.0  # time constants after which the start of a lag no longer matters


@dataclass(frozen=True, slots=True, kw_only=True)
class Greybox:
    """A chain with its charge and effects, as the graph contains it."""

    constants: Constants
    limits: Ranges  # of each input of chain and effects, which is clipped to them first
    period_s: float
    charge: Charge | None = None  # of its own, or the error of the charge that is an input
    effects: Effects = ()
    own: Effects = ()  # of the healthy vehicle, before the effects

    @classmethod
    def of(cls, card: ModelCard) -> Self:
        """Return the chain of a model's card; raises ModelError if it is of another kind."""
        if card.kind != "greybox":
            raise ModelError(f"a {card.kind} model, a greybox is wanted")
        return cls.from_entry(card, {**card.structure, "inputs": card.input_names})

    @classmethod
    def from_entry(cls, card: ModelCard, given: Mapping[str, Any]) -> Self:
        """Return the chain of an entry of a card; raises ModelError if the entry lacks a field."""
        try:
            of_each = given["constants"].items()  # each a number, or one with its error
            constants = {n: c["value"] if isinstance(c, Mapping) else c for n, c in of_each}
            charges = (of.from_card(given[key]) for key, of in KINDS.items() if given.get(key))
            limits = given["inputs"], given["inputs_low"], given["inputs_high"]
            return cls(
                constants=Constants(**constants),
                limits={name: (low, high) for name, low, high in zip(*limits, strict=True)},
                period_s=card.period_ns / 1e9,
                charge=next(charges, None),
                effects=tuple(map(ModelEffect.from_card, card.effects)),
                own=tuple(starmap(ModelEffect.with_values, given.get("own", {}).items())),
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ModelError(f"the card of a chain lacks part of its structure: {error}") from None

    def structure(self) -> dict[str, Any]:
        """Return the structure for a card, without the constants."""
        charge = self.charge
        return {
            "register_samples": self.register,
            **{k: charge.to_card() if isinstance(charge, of) else None for k, of in KINDS.items()},
            "own": {each.name: each.values.tolist() for each in self.own},
            "inputs_low": [low for low, _ in self.limits.values()],
            "inputs_high": [high for _, high in self.limits.values()],
        }

    @property
    def state_layout(self) -> StateLayout:
        """Size of the state; the reading comes first."""
        return StateLayout(self.traced(Graph(), {}, "state")[1].size, 0, 1, 1)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs of the chain and of effects."""
        return tuple(self.limits)

    @property
    def register(self) -> int:
        """Samples of phi at the valve in the state: its longest dead time."""
        return max(math.ceil(self._slowest.dead_time_s.max() / self.period_s), 1)

    @property
    def memory(self) -> int:
        """Samples after which a steady input has filled the register and the path's lags.

        Other lags of effects are not counted: a graph starts with all lags settled, and a reset of
        a wall film's ten seconds would be 5,000 steps.
        """
        path = self._slowest
        lags_s = np.max(path.mixing_s + maximum(path.sensor_rising_s, path.sensor_falling_s))
        return self.register + math.ceil(FORGOTTEN * lags_s / self.period_s)

    @property
    def _slowest(self) -> ChainPath:
        """The path at the lowest inputs with least and most air, where its times are longest."""
        lowest = {"engine_speed_rpm": SPEED_LEAST_RPM} | {n: e[0] for n, e in self.limits.items()}
        signals = {name: np.full(2, low) for name, low in lowest.items()}
        return self.path(signals | {"air_mass_mg": np.array(AIR_MG)})

    @property
    def contraction(self) -> Contraction:
        """How much of the farthest wrong start is left after 50 samples in register and lags."""
        c, period_s = self.constants, self.period_s
        start = np.zeros(CONTRACTION_SAMPLES + 1)
        start[: self.register] = PHI_MAX
        mixed = c.span * ramp_lag(start, c.mixing_s, period_s)
        gap = sensor_lag(mixed, c.sensor_s, c.sensor_s, period_s)[-1]
        return Contraction(float(gap), CONTRACTION_LIMIT, pairs=1)

    def seen(self, inputs: Mapping[str, Quantity]) -> dict[str, Quantity]:
        """Return the signals (n,) that the chain sees of its inputs (n,).

        The inputs are clipped. Engine speed is computed if it is no input; ``air_mass_mg`` comes
        from the charge map or is corrected by the charge's error, if the chain has one.
        """
        signals = {name: clip(inputs[name], *ends) for name, ends in self.limits.items()}
        signals = with_speed(signals)
        if self.charge is not None:
            signals["air_mass_mg"] = self.charge.air_mass_mg(signals, self.period_s)
        return signals

    def path(self, signals: Mapping[str, Quantity]) -> ChainPath:
        """Return the path with all effects for what the chain sees."""
        path = base_path(self.constants, signals)
        return along(path, (*self.own, *self.effects), signals, self.period_s)

    def reading(self, u: FloatArray) -> FloatArray:
        """Return the phi (n,) that the sensor reads for inputs ``u`` (n, n_inputs)."""
        signals = self.seen(dict(zip(self.inputs, u.T, strict=True)))
        return np.asarray(simulate(self.path(signals), self.period_s))

    def traced(
        self, graph: Graph, inputs: Mapping[str, str], state: str
    ) -> tuple[Value, StepTrace]:
        """Add the chain to a graph; return the reading phi and the trace with the next state.

        inputs : tensor (batch, 1) of each; state : tensor that begins with the chain's state
        """
        trace = StepTrace(graph, state, self.register)
        given = {name: Value(trace, inputs.get(name, name)) for name in self.inputs}
        return simulate(self.path(self.seen(given)), self.period_s), trace


def build(greybox: Greybox) -> ModelProto:
    """Return the graph ``step``, float32, without a card."""
    graph = Graph()
    columns = {name: graph.take("u", i, i + 1) for i, name in enumerate(greybox.inputs)}
    phi, trace = greybox.traced(graph, columns, "state")
    readable = maximum(phi, 1.0 / LAMBDA_MAX)
    graph.add("Reciprocal", [readable.name], "lambda_hat")
    graph.add("Concat", trace.next_state, "next_state", axis=1)
    return finished(graph, len(greybox.inputs), trace.size)
