"""The effects' change of the chain's reading: the chain with them minus the chain without, in phi.

Both chains stand in the graph of a network, which itself has no place where an effect could act.
They share constants and inputs, so that the chain's error mostly cancels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from training.greybox.chain import Constants, inputs_of
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.graph.chain_graph import Greybox
from training.greybox.graph.effect_inputs import SPEED, Ranges, check_there, limits_of, seeing
from training.narx.export import Graph


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainDifference(Greybox):
    """A chain with effects; what it reads beyond the same chain without them counts."""

    @classmethod
    def beside(
        cls, card: ModelCard, added: Sequence[ModelEffect], constants: Constants, ranges: Ranges
    ) -> "ChainDifference":
        """Return the difference by ``added`` effects, for the inputs and period of a card.

        ranges : low and high of each signal in the drives of the fit
        Raises ModelError if a signal is missing.
        """
        known = {each.name: (each.minimum, each.maximum) for each in card.inputs}
        available = {*known, *ranges}
        chain = inputs_of(available)
        check_there("the chain", chain, available)
        effects = tuple(seeing(each, tuple(known), ranges) for each in added)
        wanted = dict.fromkeys((*chain, *(name for each in effects for name in each.reads or ())))
        inputs = [name for name in wanted if name != SPEED or SPEED in chain]
        limits = limits_of(inputs, known, ranges)
        period_s = card.period_ns / 1e9
        return cls(constants=constants, limits=limits, period_s=period_s, effects=effects)

    @classmethod
    def from_card(cls, card: ModelCard) -> "ChainDifference":
        """Return the difference of a model's card; raises ModelError if a field is missing."""
        return cls.from_entry(card, card.structure.get("chain", {}))

    def to_card(self) -> dict[str, Any]:
        """Return the entry for a card, without the effects, see ``from_card``."""
        own = {"constants": self.constants._asdict(), "inputs": list(self.inputs)}
        return own | self.structure()

    @property
    def without(self) -> Greybox:
        """The chain without the effects."""
        return replace(self, effects=())

    @property
    def n_states(self) -> int:
        """Size of the state of both chains."""
        return self.without.state_layout.size + self.state_layout.size

    def values(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """Return the difference (n,) in phi for good signals (n,), settled at the first sample."""
        u = np.column_stack([signals[name] for name in self.inputs])
        return self.reading(u) - self.without.reading(u)

    def nodes(self, graph: Graph, signals: Mapping[str, str], state: str) -> tuple[str, str]:
        """Add both chains; return the difference (batch, 1) and their next state.

        signals : by name, in physical units, each (batch, 1); state : (batch, n_states)
        """
        without, before = self.without.traced(graph, signals, state)
        rest = graph.take(state, before.size, self.n_states)
        read, behind = self.traced(graph, signals, rest)
        ahead = graph.add("Concat", [*before.next_state, *behind.next_state], axis=1)
        return graph.add("Sub", [read.name, without.name]), ahead
