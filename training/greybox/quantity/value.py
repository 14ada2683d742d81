"""Arithmetic on arrays (n,), on those with derivatives, or on tensors of a graph, which gets nodes.

Only operations that give the same bits in every batch size are here: onnxruntime's ``Pow``,
``Exp`` and ``Tanh`` do, its ``Log`` does not.

A graph runs once per sample: what its lags and delays keep is its state. All states are 0 before
the first step. A mark tells this step from the later ones, so that in a graph, as on arrays,
everything starts settled at its first input. The state holds the reading, the mark, and what
equations keep, in the order in which they ask for a place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from monitor.base.types import FloatArray
from training.greybox.quantity.dual import Dual

if TYPE_CHECKING:
    from training.narx.export import Graph

READING = 0  # place of what the sensor reads in the state of a graph
NODES: Final = {
    np.add: "Add",
    np.subtract: "Sub",
    np.multiply: "Mul",
    np.divide: "Div",
    np.negative: "Neg",
    np.power: "Pow",
    np.absolute: "Abs",
    np.greater: "Greater",
    np.less_equal: "LessOrEqual",
    np.bitwise_and: "And",
    np.maximum: "Max",
    np.minimum: "Min",
    np.exp: "Exp",
    np.tanh: "Tanh",
}
Function = Callable[..., Any]
maximum: Function = np.maximum
minimum: Function = np.minimum
exp: Function = np.exp
tanh: Function = np.tanh
log: Function = np.log
Quantity = Any  # FloatArray (n,), Dual, Value or float; one equation has duals or values, not both


@dataclass(frozen=True, slots=True)
class Value(NDArrayOperatorsMixin):
    """A float32 tensor (batch, k) in a graph, mostly (batch, 1); numpy's functions add nodes."""

    trace: "StepTrace"
    name: str

    def __array_ufunc__(self, of: np.ufunc, _method: str, *operands: Any) -> "Value":
        return self.node(NODES[of], *operands) if of in NODES else NotImplemented

    def node(
        self, kind: str, *operands: "Value | float | FloatArray | list[int]", **attributes: Any
    ) -> "Value":
        """Add an ONNX operator of this kind; return its result."""
        names = [x.name if isinstance(x, Value) else x for x in operands]
        return Value(self.trace, self.trace.graph.add(kind, names, **attributes))

    def total(self) -> "Value":
        """Add the sum of each row, (n, 1)."""
        return self.node("ReduceSum", self, [1])


def clip(x: Quantity, low: float, high: float) -> Quantity:
    """Return ``x`` within the limits."""
    if isinstance(x, Dual):
        return maximum(minimum(x, high), low)
    return x.node("Clip", x, low, high) if isinstance(x, Value) else np.clip(x, low, high)


def where(condition: Quantity, then: Quantity, otherwise: Quantity) -> Quantity:
    """Return ``then`` where the condition holds, else ``otherwise``; of no duals."""
    if isinstance(condition, Value):
        return condition.node("Where", condition, then, otherwise)
    return np.where(condition, then, otherwise)


def bilinear(
    x: Quantity, y: Quantity, knots: tuple[FloatArray, FloatArray], maps: Sequence[FloatArray]
) -> list[Quantity]:
    """Return maps (a, b) over the same knots (a,) and (b,) at ``x`` and ``y``, constant beyond.

    Each sum has at most two terms that are not zero, so that it has the same bits in every batch.
    """
    by_row, by_column = hats(x, knots[0]), hats(y, knots[1])
    if not isinstance(x, Value):
        return [((by_row @ values) * by_column).sum(axis=1) for values in maps]
    none = np.zeros(len(knots[0]))
    rows = [by_column.node("Gemm", by_column, values, none, transB=1) for values in maps]
    return [(row * by_row).total() for row in rows]


def linear(x: Quantity, knots: FloatArray, values: FloatArray) -> Quantity:
    """Return values (k,) at knots (k,) linear between them at ``x``, constant beyond."""
    shares = hats(x, knots)
    return (shares * values).total() if isinstance(x, Value) else shares @ values


def cells(x: FloatArray, y: FloatArray, knots: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the shares (n, a * b) of the knots (a,) and (b,) in a bilinear interpolation."""
    shares = hats(x, knots[0])[:, :, None] * hats(y, knots[1])[:, None, :]
    return np.asarray(shares.reshape(len(x), knots[0].size * knots[1].size))


def knots_over(
    values: FloatArray, n: int, range_: tuple[float, float] = (0.005, 0.995), least: float = 1.0
) -> FloatArray:
    """Return knots (n,), evenly spaced over nearly all values and ``least``; 0 and 1 for none."""
    low, high = np.quantile(values, range_) if len(values) else (0.0, 1.0)
    return np.linspace(low, max(high, low + least), n)


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


class StepTrace:
    """Nodes of equations with the places of their states.

    state : name of the tensor (batch, n) that begins with this trace's state
    register : samples of the longest delay
    """

    def __init__(self, graph: "Graph", state: str, register: int) -> None:
        self.graph, self.register, self._state = graph, register, state
        self._kept: dict[int, str] = {}
        self.size = READING + 1
        mark = self.place()
        begun = self.take(state, mark)
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
        return where(self._begun, self.take(self._state, place, width), first)

    def keep(self, place: int, value: Value) -> Value:
        """Keep a value for the next step; return it."""
        self._kept[place] = value.name
        return value

    def take(self, source: str, first: int, width: int = 1) -> Value:
        """Add some columns of a tensor."""
        return Value(self, self.graph.take(source, first, first + width))
