"""Effects on fuel and charge before a network: its inputs as a vehicle without them sends them.

For the same mixture in the cylinder its ECU would command other fuel, and its lambda controller
would stand higher by as much. So the network reads what it was trained on, however large the effect
is, where added to its output it would have to be right far outside its training first.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.greybox.chain import AIR_LEAST_MG, STOICHIOMETRIC, Path, valve_phi
from training.greybox.effects.form.value import Value, clip, maximum, where
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.graph.chain_difference import ChainDifference
from training.greybox.graph.chain_graph import FORGOTTEN, Greybox
from training.greybox.graph.effect import effects_nodes
from training.greybox.graph.effect_parity import path_with
from training.greybox.graph.nodes import base_nodes, speed_nodes, valve_nodes
from training.narx.export import Graph

FUEL: Final = "fuel_mass_mg"
CONTROLLER: Final = "lambda_controller"
CORRECTED: Final = (FUEL, CONTROLLER)
LIMITS: Final = CONFIG.add
RATIO: Final = (LIMITS.controller_ratio_min, LIMITS.controller_ratio_max)
LEAST_MG: Final = LIMITS.controller_fuel_min_mg
UP_TO_THE_VALVE: Final = ("fuel_mg", "air_mg", "factor")  # fields of a path


def acts_before(
    added: Sequence[ModelEffect], path: Path, signals: Mapping[str, FloatArray]
) -> bool:
    """Return whether effects change fuel and charge only, nothing from the valve to the reading.

    path, signals : of any drive, (n,) each
    """
    for each in added:
        moved = each.effect.apply(path, each.values, signals, 1.0)
        for name in (field.name for field in fields(Path)):
            if name not in UP_TO_THE_VALVE and getattr(moved, name) is not getattr(path, name):
                return False
    return True


@dataclass(frozen=True, slots=True)
class Before:
    """Inputs of a network as they would be without the effects of a chain."""

    chain: ChainDifference  # its constants, effects and the ranges of its inputs

    @property
    def _with(self) -> Greybox:
        return self.chain.with_effects

    @property
    def n_states(self) -> int:
        """How much the effects remember."""
        return sum(effect.n_states for effect in self._with.effects)

    @property
    def memory(self) -> int:
        """Samples after which the effects have forgotten how they began."""
        greybox = self._with
        return math.ceil(FORGOTTEN * sum(e.lag_s for e in greybox.effects) / greybox.period_s)

    def values(self, signals: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Return fuel, and the controller if it is among them, for signals (n,)."""
        chain = self.chain.without
        seen = chain.signals(np.column_stack([signals[name] for name in chain.inputs]))
        air_mg = np.maximum(chain.path(seen).air_mg, AIR_LEAST_MG)
        phi = valve_phi(path_with(chain, self.chain.entries, seen))
        fuel_mg = phi * air_mg / (STOICHIOMETRIC * chain.constants.gain)
        corrected = {FUEL: fuel_mg}
        if CONTROLLER in signals:
            old_mg = seen[FUEL]
            ratio = np.clip(fuel_mg / np.maximum(old_mg, LEAST_MG), *RATIO)
            corrected[CONTROLLER] = signals[CONTROLLER] * np.where(old_mg > LEAST_MG, ratio, 1.0)
        return corrected

    def nodes(
        self, graph: Graph, signals: Mapping[str, str], state: str
    ) -> tuple[dict[str, str], list[str]]:
        """Add the effects; return the corrected inputs (batch, 1) and the parts of the next state.

        signals : by name, in physical units, each (batch, 1), the controller if there is one;
        state : (batch, n_states)
        """
        graph, greybox = graph.part("before_"), self._with
        seen = self.chain.clipped(graph, signals)
        if "engine_speed_rpm" not in seen:
            seen["engine_speed_rpm"] = speed_nodes(graph, seen)
        base = base_nodes(graph, greybox.constants, seen)
        nodes, kept = effects_nodes(
            graph, greybox.effects, path=base, signals=seen, state=state, first=0
        )
        phi, air_mg = Value(graph, valve_nodes(graph, nodes)), Value(graph, base.air_mg)
        old_mg = Value(graph, seen[FUEL])
        fuel_mg = phi * maximum(air_mg, AIR_LEAST_MG) / (STOICHIOMETRIC * greybox.constants.gain)
        corrected = {FUEL: fuel_mg.name}
        if CONTROLLER in signals:
            ratio = clip(fuel_mg / maximum(old_mg, LEAST_MG), *RATIO)
            ratio = where(old_mg > LEAST_MG, ratio, 1.0)
            corrected[CONTROLLER] = (Value(graph, signals[CONTROLLER]) * ratio).name
        return corrected, kept
