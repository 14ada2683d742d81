"""Arithmetic on arrays (n,) or on tensors of a graph, to which it adds nodes.

Only operations that give the same bits in every batch size are here: onnxruntime's ``Pow``,
``Exp`` and ``Tanh`` do, its ``Log`` does not.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from training.narx.export import Graph

Quantity = Any  # FloatArray (n,), Value or float; all of one equation but floats are alike


@dataclass(frozen=True, slots=True)
class Value:
    """A float32 tensor (batch, 1) or scalar in a graph; each operation adds a node."""

    graph: "Graph"
    name: str

    def __add__(self, other: "Value | float") -> "Value":
        return self.node("Add", self, other)

    def __radd__(self, other: float) -> "Value":
        return self.node("Add", self, other)

    def __sub__(self, other: "Value | float") -> "Value":
        return self.node("Sub", self, other)

    def __rsub__(self, other: float) -> "Value":
        return self.node("Sub", other, self)

    def __mul__(self, other: "Value | float") -> "Value":
        return self.node("Mul", self, other)

    def __rmul__(self, other: float) -> "Value":
        return self.node("Mul", self, other)

    def __truediv__(self, other: "Value | float") -> "Value":
        return self.node("Div", self, other)

    def __rtruediv__(self, other: float) -> "Value":
        return self.node("Div", other, self)

    def __neg__(self) -> "Value":
        return self.node("Neg", self)

    def __pow__(self, other: "Value | float") -> "Value":
        return self.node("Pow", self, other)

    def __gt__(self, other: "Value | float") -> "Value":
        return self.node("Greater", self, other)

    def __le__(self, other: "Value | float") -> "Value":
        return self.node("LessOrEqual", self, other)

    def __and__(self, other: "Value") -> "Value":
        return self.node("And", self, other)

    def node(self, kind: str, *operands: "Value | float") -> "Value":
        """Add an ONNX operator of this kind; return its result."""
        graph, names = self.graph, list[str]()
        for x in operands:
            if isinstance(x, Value):
                names.append(x.name)
            else:
                names.append(graph.constant(f"c{len(graph.constants)}", x))
        return Value(graph, graph.add(kind, names, f"n{len(graph.nodes)}"))


def maximum(x: Quantity, least: Quantity) -> Quantity:
    """Return the larger of the two."""
    return x.node("Max", x, least) if isinstance(x, Value) else np.maximum(x, least)


def minimum(x: Quantity, most: Quantity) -> Quantity:
    """Return the smaller of the two."""
    return x.node("Min", x, most) if isinstance(x, Value) else np.minimum(x, most)


def clip(x: Quantity, low: float, high: float) -> Quantity:
    """Return ``x`` within the limits."""
    return x.node("Clip", x, low, high) if isinstance(x, Value) else np.clip(x, low, high)


def exp(x: Quantity) -> Quantity:
    """Return e to the power of ``x``."""
    return x.node("Exp", x) if isinstance(x, Value) else np.exp(x)


def tanh(x: Quantity) -> Quantity:
    """Return the hyperbolic tangent."""
    return x.node("Tanh", x) if isinstance(x, Value) else np.tanh(x)


def where(condition: Quantity, then: Quantity, otherwise: Quantity) -> Quantity:
    """Return ``then`` where the condition holds, else ``otherwise``."""
    if isinstance(condition, Value):
        return condition.node("Where", condition, then, otherwise)
    return np.where(condition, then, otherwise)
