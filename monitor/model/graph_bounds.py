"""An ONNX graph within bounds: operators, weights and sizes that a model may have.

A graph of a few kilobytes can ask for terabytes: a sum of a column and a row, a table that is
joined with itself forty times, a loop. So only operators are taken whose result's size follows from
their inputs' sizes, and all sizes are added up before the graph is loaded.
"""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.model.protobuf import BYTES, Field, Parts, content, number, numbers, text

MOST_ELEMENTS: Final = 4_000_000  # of all tensors of one step together
MOST_PRODUCTS: Final = 200_000_000  # multiplications of one step
MOST_RANK: Final = 4
Shape = tuple[int, ...]  # upper bounds, for a batch of one
_ELEMENTWISE: Final = frozenset(
    {
        *("Abs", "Add", "And", "Cast", "Ceil", "Clip", "Cos", "Div", "Elu", "Equal", "Erf", "Exp"),
        *("Floor", "Greater", "GreaterOrEqual", "HardSigmoid", "Identity", "LeakyRelu", "Less"),
        *("LessOrEqual", "Log", "Max", "Mean", "Min", "Mod", "Mul", "Neg", "Not", "Or", "Pow"),
        *("Reciprocal", "Relu", "Round", "Selu", "Sigmoid", "Sign", "Sin", "Softplus", "Softsign"),
        *("Sqrt", "Sub", "Sum", "Tanh", "Where", "Xor"),
    }
)
_SMALLER: Final = frozenset({"ReduceMax", "ReduceMean", "ReduceMin", "ReduceSum", "Slice"})
# data types of TensorProto, and the fields that hold numbers of one where they are not raw
_TYPES: Final = {1: "<f4", 7: "<i8", 9: "?", 11: "<f8"}
_RAW: Final = 9
_FLOAT_DATA: Final = {4: "<f4", 10: "<f8"}
_INTEGERS: Final = 7
_TENSOR_KNOWN: Final = frozenset({1, 2, 4, 5, _INTEGERS, 8, _RAW, 10, 11, 12})  # no external data


class Node(NamedTuple):
    """A node of the graph."""

    kind: str
    inputs: list[str]
    outputs: list[str]
    whole: dict[str, int]  # attributes that are whole numbers


class StepGraph(NamedTuple):
    """Operators in the order in which they run, and the constants they use."""

    nodes: list[Node]
    constants: dict[str, NDArray[Any]]


def graph_of(graph: memoryview, parts: Parts) -> StepGraph:
    """Return a graph; raises ValueError if it exceeds a bound or a weight is not finite."""
    nodes, shapes, constants = list[Node](), dict[str, Shape](), dict[str, NDArray[Any]]()
    for field in parts.fields(graph):
        match field.number:
            case 1:
                nodes.append(_node(content(field), parts))
            case 5:
                name, shapes[name], constants[name] = _tensor(content(field), parts)
            case 11:
                name, shape = _input(content(field), parts)
                shapes.setdefault(name, shape)
            case 2 | 10 | 12 | 13:  # name, text, outputs, shapes of tensors between
                continue
            case other:
                raise ValueError(f"its graph has a part that no model has (field {other})")
    elements, products = sum(map(math.prod, shapes.values())), 0
    for node in nodes:
        shape, cost = _result(node, [shapes.get(name, ()) for name in node.inputs])
        elements, products = elements + math.prod(shape) * len(node.outputs), products + cost
        if elements > MOST_ELEMENTS or products > MOST_PRODUCTS or len(shape) > MOST_RANK:
            raise ValueError("one step of it is too large to compute")
        shapes.update(dict.fromkeys(node.outputs, shape))
    return StepGraph(nodes, constants)


def _result(node: Node, inputs: Sequence[Shape]) -> tuple[Shape, int]:
    """Return the largest shape of a node's results, and its multiplications."""
    if node.kind in _ELEMENTWISE:
        return _broadcast(inputs), 0
    if node.kind in _SMALLER and inputs:
        return inputs[0], 0
    if node.kind == "Concat" and inputs:
        return _joined(inputs, node.whole.get("axis", 0)), 0
    if node.kind in ("Gemm", "MatMul") and len(inputs) >= 2:
        a, b = (_matrix(shape) for shape in inputs[:2])
        a = a[::-1] if node.whole.get("transA") else a
        b = b[::-1] if node.whole.get("transB") else b
        return (a[0], b[1]), a[0] * a[1] * b[1]
    if node.kind == "Unsqueeze" and inputs:
        return (max(inputs[0], default=1),) * (len(inputs[0]) + 1), 0
    if node.kind == "Squeeze" and inputs:
        return inputs[0], 0
    raise ValueError(f"its graph has an operator that no model has: {node.kind[:40]!r}")


def _broadcast(shapes: Sequence[Shape]) -> Shape:
    rank = max(map(len, shapes), default=0)
    padded = [(1,) * (rank - len(shape)) + shape for shape in shapes]
    return tuple(map(max, zip(*padded, strict=True)))


def _joined(shapes: Sequence[Shape], axis: int) -> Shape:
    whole = list(_broadcast(shapes))
    axis = axis - 2**64 if axis >= 2**63 else axis  # a negative varint
    if not -len(whole) <= axis < len(whole):
        raise ValueError("its graph joins along an axis that is not there")
    whole[axis] = sum(shape[axis] for shape in shapes if len(shape) == len(whole))
    return tuple(whole)


def _matrix(shape: Shape) -> Shape:
    if len(shape) > 2:
        raise ValueError("its graph multiplies tensors that are no matrices")
    return (1,) * (2 - len(shape)) + shape


def _node(node: memoryview, parts: Parts) -> Node:
    """Return a node of a graph; raises ValueError if no model has its like."""
    found = Node("", [], [], {})
    for field in parts.fields(node):
        match field.number:
            case 1:
                found.inputs.append(text(field))
            case 2:
                found.outputs.append(text(field))
            case 4:
                found = found._replace(kind=text(field))
            case 5:
                _attribute(content(field), parts, found.whole)
            case 7 if text(field):
                raise ValueError("its graph has operators of a library of its own")
    return found


def _attribute(attribute: memoryview, parts: Parts, whole: dict[str, int]) -> None:
    name = ""
    for field in parts.fields(attribute):
        match field.number:
            case 1:
                name = text(field)
            case 3:
                whole[name] = number(field)
            case 2 | 4 | 7 | 8 | 13 | 20 | 21:  # numbers and texts
                continue
            case other:
                raise ValueError(f"its graph has a part that no model has (attribute {other})")


def _tensor(tensor: memoryview, parts: Parts) -> tuple[str, Shape, NDArray[Any]]:
    """Return name, shape and numbers of a constant; raises ValueError if they are not finite."""
    name, dims, kind = "", list[int](), 0
    values: list[Field] = []
    for field in parts.fields(tensor):
        if field.number not in _TENSOR_KNOWN:
            raise ValueError(f"its graph has a part that no model has (tensor {field.number})")
        if field.number == 1:
            dims += numbers(field)
        elif field.number == 2:
            kind = number(field)
        elif field.number == 8:
            name = text(field)
        elif field.number in (_INTEGERS, _RAW, *_FLOAT_DATA):
            values.append(field)
    found = [
        _numbers(each, _FLOAT_DATA.get(each.number) or _TYPES.get(kind), name) for each in values
    ]
    if len(dims) > MOST_RANK or math.prod(dims) > MOST_ELEMENTS:
        raise ValueError(f"its constant {name[:40]!r} is too large")
    return name, tuple(dims), np.concatenate([np.empty(0, "?"), *found])


def _numbers(field: Field, dtype: str | None, name: str) -> NDArray[Any]:
    if field.number == _INTEGERS:
        return np.array([each % 2**64 for each in numbers(field)], np.uint64).astype(np.int64)
    if dtype is None:
        return np.empty(0)
    n_bytes = np.dtype(dtype).itemsize
    if isinstance(field.value, int) or (field.wire == BYTES and len(field.value) % n_bytes):
        raise ValueError(f"its constant {name[:40]!r} is cut off")
    found = np.frombuffer(field.value, dtype)
    if not np.isfinite(found).all():
        raise ValueError(f"its constant {name[:40]!r} is not finite")
    return found


def _input(value: memoryview, parts: Parts) -> tuple[str, Shape]:
    """Return name and shape of an input; a dimension without a number is the batch, one row."""
    name = ""
    shape: Shape = ()
    for field in parts.fields(value):
        if field.number == 1:
            name = text(field)
        elif field.number == 2:
            shape = _dims(content(field), parts)
    if len(shape) > MOST_RANK or math.prod(shape) > MOST_ELEMENTS:
        raise ValueError(f"its input {name[:40]!r} is too large")
    return name, shape


def _dims(kind: memoryview, parts: Parts) -> Shape:
    """Return the shape in a TypeProto: tensor_type → shape → dim → dim_value."""
    tensors = [content(f) for f in parts.fields(kind) if f.number == 1]
    shapes = [content(f) for tensor in tensors for f in parts.fields(tensor) if f.number == 2]
    dims = [content(f) for shape in shapes for f in parts.fields(shape) if f.number == 1]
    return tuple(next((number(f) for f in parts.fields(dim) if f.number == 1), 1) for dim in dims)
