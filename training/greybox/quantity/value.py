"""Arithmetic on arrays (n,), on those with derivatives, or on tensors of a graph, which gets nodes.

Only operations that give the same bits in every batch size are here: onnxruntime's ``Pow``,
``Exp`` and ``Tanh`` do, its ``Log`` does not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.quantity.dual import Dual, moved, value_of

if TYPE_CHECKING:
    from training.greybox.quantity.trace import StepTrace

READING = 0  # place of what the sensor reads in the state of a graph
Quantity = Any  # FloatArray (n,), Dual, Value or float; one equation has duals or values, not both


@dataclass(frozen=True, slots=True)
class Value:
    """A float32 tensor (batch, k) in a graph, mostly (batch, 1); each operation adds a node."""

    trace: "StepTrace"
    name: str

    __array_ufunc__ = None  # so that an array on the left leaves the operation to the value

    def __add__(self, other: "Value | float") -> "Value":
        return self.node("Add", self, other)

    __radd__ = __add__

    def __sub__(self, other: "Value | float") -> "Value":
        return self.node("Sub", self, other)

    def __rsub__(self, other: float) -> "Value":
        return self.node("Sub", other, self)

    def __mul__(self, other: "Value | float") -> "Value":
        return self.node("Mul", self, other)

    __rmul__ = __mul__

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

    def node(
        self, kind: str, *operands: "Value | float | FloatArray", **attributes: int
    ) -> "Value":
        """Add an ONNX operator of this kind; return its result."""
        values = [x if isinstance(x, Value) else self.trace.constant(x) for x in operands]
        graph = self.trace.graph
        names, name = [x.name for x in values], f"n{len(graph.nodes)}"
        return Value(self.trace, graph.add(kind, names, name, **attributes))

    def total(self, axis: int, *, keepdims: bool = False) -> "Value":
        """Add the sum over an axis."""
        return self.node(
            "ReduceSum", self, self.trace.constant([axis], np.int64), keepdims=keepdims
        )


def maximum(x: Quantity, least: Quantity) -> Quantity:
    """Return the larger of the two."""
    if isinstance(x, Value):
        return x.node("Max", x, least)
    return _chosen(np.maximum, x, least)


def minimum(x: Quantity, most: Quantity) -> Quantity:
    """Return the smaller of the two."""
    if isinstance(x, Value):
        return x.node("Min", x, most)
    return _chosen(np.minimum, x, most)


def clip(x: Quantity, low: float, high: float) -> Quantity:
    """Return ``x`` within the limits."""
    if isinstance(x, Dual):
        return maximum(minimum(x, high), low)
    return x.node("Clip", x, low, high) if isinstance(x, Value) else np.clip(x, low, high)


def exp(x: Quantity) -> Quantity:
    """Return e to the power of ``x``."""
    return x.node("Exp", x) if isinstance(x, Value) else _followed(x, np.exp, lambda y: y)


def tanh(x: Quantity) -> Quantity:
    """Return the hyperbolic tangent."""
    if isinstance(x, Value):
        return x.node("Tanh", x)
    return _followed(x, np.tanh, lambda y: 1.0 - y * y)


def log(x: Quantity) -> Quantity:
    """Return the natural logarithm, not in a graph."""
    return _followed(x, np.log, lambda y: np.exp(-y))


def where(condition: Quantity, then: Quantity, otherwise: Quantity) -> Quantity:
    """Return ``then`` where the condition holds, else ``otherwise``."""
    if isinstance(condition, Value):
        return condition.node("Where", condition, then, otherwise)
    value = np.where(condition, value_of(then), value_of(otherwise))
    if not (isinstance(then, Dual) or isinstance(otherwise, Dual)):
        return value
    return moved(value, (then, condition), (otherwise, ~condition))


def _followed(x: Quantity, of: Callable[[Any], Any], slope: Callable[[Any], Any]) -> Quantity:
    """Return a function of an array or dual; ``slope`` is its derivative for its own value."""
    y = of(value_of(x))
    return moved(y, (x, slope(y))) if isinstance(x, Dual) else y


def _chosen(of: Callable[[Any, Any], Any], x: Quantity, other: Quantity) -> Quantity:
    """Return the chosen of two arrays or duals."""
    y = of(value_of(x), value_of(other))
    if not (isinstance(x, Dual) or isinstance(other, Dual)):
        return y
    first = np.asarray(y == value_of(x))
    if first.all():
        return moved(y, (x, 1.0))
    return moved(y, (x, first), (other, ~first))


def bilinear(
    x: Quantity, y: Quantity, knots: tuple[FloatArray, FloatArray], maps: Sequence[FloatArray]
) -> list[Quantity]:
    """Return maps (a, b) over the same knots (a,) and (b,) at ``x`` and ``y``, constant beyond.

    Each sum has at most two terms that are not zero, so that it has the same bits in every batch.
    """
    by_row, by_column = hats(x, knots[0]), hats(y, knots[1])
    if not isinstance(x, Value):
        return [((by_row @ values) * by_column).sum(axis=1) for values in maps]
    wide = by_column.node("Unsqueeze", by_column, x.trace.constant([1], np.int64))  # (n, 1, b)
    rows = [(wide * values[None]).total(2) for values in maps]
    return [(row * by_row).total(1, keepdims=True) for row in rows]


def cells(x: FloatArray, y: FloatArray, knots: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the shares (n, a * b) of the knots (a,) and (b,) in a bilinear interpolation."""
    shares = hats(x, knots[0])[:, :, None] * hats(y, knots[1])[:, None, :]
    return np.asarray(shares.reshape(len(x), knots[0].size * knots[1].size))


def hats(x: Quantity, knots: FloatArray) -> Quantity:
    """Return the shares (n, k) of the knots in a linear interpolation at ``x``.

    >>> hats(np.array([0.0, 15.0, 99.0]), np.array([10.0, 20.0, 40.0])).tolist()
    [[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]]
    """
    gaps = np.diff(knots)
    column = x if isinstance(x, Value) else np.asarray(x)[:, None]
    away = clip(column, knots[0], knots[-1]) - knots[None]
    rising = 1.0 + away / np.append(gaps[:1], gaps)[None]
    falling = 1.0 - away / np.append(gaps, gaps[-1:])[None]
    return maximum(minimum(rising, falling), 0.0)
