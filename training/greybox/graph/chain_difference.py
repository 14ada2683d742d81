"""The effects' change of the chain's reading: the chain with them minus the chain without, in phi.

Both chains stand in the graph of a network, which itself has no place where an effect could act.
They share constants and inputs, so that the chain's error mostly cancels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.card import Channel, ModelCard, TrainingRecording
from training.greybox.chain import Constants, inputs_of
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.graph.chain_graph import (
    Greybox,
    chain_nodes,
    longest_dead_time_s,
    register_for,
)
from training.greybox.graph.effect import graph_effect
from training.greybox.graph.effect_inputs import SPEED, Ranges, limits_of, reads_of
from training.greybox.graph.effect_parity import Entry, reading
from training.narx.export import Graph

PHI_PLACES = 4  # states of a chain, beside the register, that hold a phi


@dataclass(frozen=True, slots=True)
class ChainDifference:
    """Two chains that differ in their effects."""

    without: Greybox
    entries: tuple[Entry, ...]

    @classmethod
    def of(
        cls,
        card: ModelCard,
        added: Sequence[ModelEffect],
        constants: Constants,
        ranges: Ranges,
    ) -> "ChainDifference":
        """Return the difference by ``added`` effects, for the inputs and period of a card.

        ranges : low and high of each signal in the drives of the fit
        Raises ModelError if a signal is missing.
        """
        known = {channel.name: channel for channel in card.inputs}
        available = {*known, *ranges}
        missing = [name for name in inputs_of(available) if name not in available]
        if missing:
            raise ModelError(
                f"the chain needs {', '.join(missing)}: neither an input of the model nor in the "
                "drives of the fit"
            )
        reads = [reads_of(each, tuple(known), ranges) for each in added]
        chain = inputs_of(available)
        wanted = dict.fromkeys((*chain, *(name for each in reads for name in each)))
        inputs = tuple(name for name in wanted if name != SPEED or SPEED in chain)
        bounds = np.array(
            [limits_of(name, _trained(known.get(name)), ranges.get(name)) for name in inputs]
        )
        bounds[inputs.index("fuel_mass_mg"), 0] = 0.0  # fuel cut must reach the chain
        entries = tuple(Entry(each, names) for each, names in zip(added, reads, strict=True))
        period_s = card.period_ns / 1e9
        longest_s = longest_dead_time_s(constants, inputs, bounds[:, 0])
        longest_s += sum(effect.dead_time_s for effect in _effects(entries, period_s))
        register = register_for(longest_s, period_s)
        low, high = bounds.T
        without = Greybox(
            constants=constants,
            inputs=inputs,
            u_low=low,
            u_high=high,
            period_s=period_s,
            register=register,
        )
        return cls(without, entries)

    @classmethod
    def from_card(cls, card: ModelCard) -> "ChainDifference":
        """Return the difference of a model's card; raises ModelError if a field is missing."""
        try:
            given = card.structure["chain"]
            low, high = (np.array(given[name]) for name in ("inputs_low", "inputs_high"))
            without = Greybox(
                constants=Constants(**given["constants"]),
                inputs=tuple(given["inputs"]),
                u_low=low,
                u_high=high,
                period_s=card.period_ns / 1e9,
                register=int(given["register_samples"]),
            )
            return cls(without, tuple(Entry.of(entry) for entry in card.effects))
        except (KeyError, TypeError) as error:
            raise ModelError(f"the card lacks part of its added effects: {error}") from None

    def to_card(self) -> dict[str, Any]:
        """Return the entry for a card, without the effects, see ``from_card``."""
        return {
            "constants": self.without.constants._asdict(),
            "inputs": list(self.inputs),
            "inputs_low": self.without.u_low.tolist(),
            "inputs_high": self.without.u_high.tolist(),
            "register_samples": self.without.register,
        }

    def effects_to_card(self, recordings: Sequence[TrainingRecording]) -> list[dict[str, Any]]:
        """Return the entries for the card's effects, fitted to ``recordings``."""
        came_from = [asdict(recording) for recording in recordings]
        return [
            entry.added.to_card() | {"reads": list(entry.reads), "recordings": came_from}
            for entry in self.entries
        ]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the signals that the two chains read."""
        return self.without.inputs

    @property
    def with_effects(self) -> Greybox:
        """The chain with the effects."""
        effects = _effects(self.entries, self.without.period_s)
        return replace(self.without, effects=effects)

    @property
    def n_states(self) -> int:
        """Size of the state of both chains."""
        return self.without.state_layout.size + self.with_effects.state_layout.size

    @property
    def memory(self) -> int:
        """Samples after which both chains have forgotten how they began."""
        return self.with_effects.memory

    def values(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """Return the difference (n,) in phi for signals (n,) in physical units, all of them good.

        Both chains start settled at the first sample.
        """
        u = np.column_stack([signals[name] for name in self.inputs])
        return reading(self.without, self.entries, u) - reading(self.without, (), u)

    def nodes(self, graph: Graph, signals: Mapping[str, str], state: str) -> tuple[str, str]:
        """Add both chains; return the difference (batch, 1) and their next state.

        signals : by name, in physical units, each (batch, 1); state : (batch, n_states), in which
        phi is held as its distance from 1: a state of zeros is a steady stoichiometric mixture.
        """
        graph = graph.part("chain_")
        inputs = self.clipped(graph, signals)
        phi, parts, at, offset = [], list[str](), 0, _offset(self.without, self.with_effects)
        middle = graph.constant("middle", offset[None])
        state = graph.add("Add", [state, middle], "state")
        for name, chain in (("without_", self.without), ("with_", self.with_effects)):
            own, size = graph.part(name), chain.state_layout.size
            one, following = chain_nodes(
                own, chain, inputs, own.take(state, at, at + size, "state")
            )
            phi.append(one)
            parts += following
            at += size
        ahead = graph.add("Concat", parts, "next", axis=1)
        difference = graph.add("Sub", [phi[1], phi[0]], "difference")
        return difference, graph.add("Sub", [ahead, middle], "next_state")

    def clipped(self, graph: Graph, signals: Mapping[str, str]) -> dict[str, str]:
        """Add the inputs, limited to their ranges; return them by name."""
        limited = {}
        for i, name in enumerate(self.inputs):
            bounds = [
                graph.constant(f"{name}_low", self.without.u_low[i]),
                graph.constant(f"{name}_high", self.without.u_high[i]),
            ]
            limited[name] = graph.add("Clip", [signals[name], *bounds], f"{name}_clipped")
        return limited


def _effects(entries: Sequence[Entry], period_s: float) -> tuple[Any, ...]:
    return tuple(graph_effect(entry.added, period_s, entry.reads) for entry in entries)


def _trained(channel: Channel | None) -> tuple[float, float] | None:
    return None if channel is None else (channel.minimum, channel.maximum)


def _offset(*chains: Greybox) -> FloatArray:
    """Return 1 for each state of the chains that holds a phi, 0 for those of effects."""
    sizes = [(PHI_PLACES + chain.register, chain.state_layout.size) for chain in chains]
    return np.concatenate([np.arange(size) < phis for phis, size in sizes]).astype(np.float64)
