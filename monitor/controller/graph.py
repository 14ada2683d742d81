"""The graph of a model file: its nodes in order and its constants as arrays.

Reading it here costs no library; ``graph_bounds`` has checked the same bytes before.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from monitor.model import model_file
from monitor.model.graph_bounds import Node, node_of
from monitor.model.protobuf import Parts, content, number, numbers, text

_GRAPH: Final = 7  # field of ModelProto
# data types of TensorProto, and the fields that hold them where they are not raw
_TYPES: Final = {1: "<f4", 7: "<i8", 9: "?", 11: "<f8"}
_OWN: Final = {4: "<f4", 10: "<f8"}


@dataclass(frozen=True, slots=True)
class ModelGraph:
    """Operators in the order in which they run, and the constants they use."""

    nodes: list[Node]
    constants: dict[str, NDArray[Any]]


def read(path: Path) -> ModelGraph:
    """Return the graph of a model file; raises ModelError if it is none."""
    model = model_file.read(path).content
    parts = Parts(model_file.MOST_PARTS)
    found = ModelGraph([], {})
    for part in parts.fields(memoryview(model)):
        if part.number != _GRAPH:
            continue
        for each in parts.fields(content(part)):
            if each.number == 1:
                found.nodes.append(node_of(content(each), parts))
            elif each.number == 5:
                name, values = _constant(content(each), parts)
                found.constants[name] = values
    return found


def _constant(tensor: memoryview, parts: Parts) -> tuple[str, NDArray[Any]]:
    name, dims, kind, found = "", list[int](), 0, list[NDArray[Any]]()
    for part in parts.fields(tensor):
        if part.number == 1:
            dims += numbers(part)
        elif part.number == 2:
            kind = number(part)
        elif part.number == 8:
            name = text(part)
        elif part.number == 7:
            found.append(np.array(numbers(part), dtype=np.uint64).astype(np.int64))
        elif part.number in _OWN or part.number == 9:
            found.append(np.frombuffer(content(part), _OWN.get(part.number) or _TYPES[kind]))
    values = np.concatenate(found) if found else np.zeros(math.prod(dims))
    return name, values.reshape(dims)
