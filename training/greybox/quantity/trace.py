"""A graph under construction that runs once per sample: what its lags and delays keep is its state.

All states are 0 before the first step. A mark tells this step from the later ones, so that in a
graph, as on arrays, everything starts settled at its first input. The state holds the reading, the
mark, and what equations keep, in the order in which they ask for a place.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from training.greybox.quantity.value import READING, Value, clip, where

if TYPE_CHECKING:
    from training.narx.export import Graph


class StepTrace:
    """Nodes of equations with the places of their states.

    state : name of the tensor (batch, n), of which the columns from ``first`` on are this trace's
    register : samples of the longest delay
    """

    def __init__(self, graph: "Graph", state: str, register: int, first: int = 0) -> None:
        self.graph, self.register = graph, register
        self._state, self._first = state, first
        self._kept: dict[int, str] = {}
        self.size = READING + 1
        mark = self.place()
        begun = self.take(state, first + mark)
        self._begun = begun > 0.5
        self.keep(mark, clip(begun, 1.0, 1.0))

    @property
    def next_state(self) -> list[str]:
        """Return the parts of the next state."""
        return [self._kept[place] for place in sorted(self._kept)]

    def place(self, width: int = 1) -> int:
        """Return a new place in the state."""
        self.size += width
        return self.size - width

    def old(self, place: int, first: Value, width: int = 1) -> Value:
        """Return what was kept at a place, ``first`` in the first step."""
        return where(self._begun, self.take(self._state, self._first + place, width), first)

    def keep(self, place: int, value: Value) -> Value:
        """Keep a value for the next step; return it."""
        self._kept[place] = value.name
        return value

    def take(self, source: str, first: int, width: int = 1) -> Value:
        """Add some columns of a tensor."""
        name = f"n{len(self.graph.nodes)}"
        return Value(self, self.graph.take(source, first, first + width, name))

    def constant(self, value: Any, dtype: type = np.float32) -> Value:
        """Add a constant."""
        name = f"c{len(self.graph.constants)}"
        return Value(self, self.graph.constant(name, value, dtype))
