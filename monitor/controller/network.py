"""The model's step as C: each operator of its graph becomes a loop over one row.

The batch has one row, so every tensor is a vector; a scalar is a vector of one. That is enough for
networks of any layers with their state and for grey-box chains; a graph with more dimensions, as of
chains from older versions, is refused with the operator's name.
"""

import re
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from monitor.base.errors import ModelError
from monitor.model.graph_bounds import Node, StepGraph

# operator → C expression of its inputs
_ELEMENTWISE: Final[dict[str, str]] = {
    "Abs": "fabsf({0})",
    "Add": "{0} + {1}",
    "Clip": "fminf(fmaxf({0}, {1}), {2})",
    "Div": "{0} / {1}",
    "Exp": "expf({0})",
    "Greater": "({0} > {1}) ? 1.0f : 0.0f",
    "Identity": "{0}",
    "Log": "logf({0})",
    "Max": "fmaxf({0}, {1})",
    "Min": "fminf({0}, {1})",
    "Mul": "{0} * {1}",
    "Neg": "-{0}",
    "Reciprocal": "1.0f / {0}",
    "Sigmoid": "1.0f / (1.0f + expf(-{0}))",
    "Sqrt": "sqrtf({0})",
    "Sub": "{0} - {1}",
    "Tanh": "tanhf({0})",
    "Where": "({0} != 0.0f) ? {1} : {2}",
}
_HEAD: Final = """/* The model's step, generated from the graph of {name} by "o2-monitor". */
#include "o2_tables.h"

#include <math.h>
"""


def literal(value: float) -> str:
    """Return a number as a float constant of C, the shortest that is the same float.

    >>> literal(0.1), literal(float("-inf")), literal(3.0)
    ('0.1f', '-INFINITY', '3.0f')
    """
    if not np.isfinite(value):
        return "NAN" if np.isnan(value) else "INFINITY" if value > 0.0 else "-INFINITY"
    return f"{np.float32(value)!s}f"


def vector(kind: str, name: str, values: Sequence[str], *, is_shared: bool = False) -> str:
    """Return an array of C with its values in lines."""
    rows = [", ".join(values[i : i + 8]) for i in range(0, len(values), 8)]
    inner = ",\n    ".join(rows)
    return f"{'' if is_shared else 'static '}const {kind} {name} = {{\n    {inner}}};\n"


class _Code:
    """C under construction: constants, and the lines of the step."""

    def __init__(self, graph: StepGraph, widths: dict[str, int]) -> None:
        self.given, self.widths = graph.constants, dict(widths)
        self.names = {name: name for name in widths}  # tensor → C
        self.constants: list[str] = []
        self.lines: list[str] = []

    def use(self, name: str) -> str:
        """Return the C name of a tensor; a constant is written down with its first use."""
        if name not in self.names:
            values = self.given[name]
            own = self._new(name, values.size)
            self.constants.append(
                vector("float", f"{own}[{values.size}]", [literal(v) for v in values.ravel()])
            )
        return self.names[name]

    def result(self, name: str, width: int) -> str:
        """Declare the result of an operator."""
        own = self._new(name, width)
        self.lines.append(f"    float {own}[{width}];")
        return own

    def _new(self, name: str, width: int) -> str:
        own = re.sub(r"\W", "_", name)[:40]
        own = f"t_{own}" if f"t_{own}" not in self.names.values() else f"t{len(self.names)}_{own}"
        self.names[name], self.widths[name] = own, width
        return own

    def loop(self, width: int, body: str) -> None:
        """Add a loop over a row."""
        self.lines.append(
            f"    for (uint16_t i = 0U; i < {width}U; i++) {{\n        {body}\n    }}"
        )


def step_code(graph: StepGraph, prediction: str, n_inputs: int, n_state: int, name: str) -> str:
    """Return the C source of one step.

    prediction : tensor that holds the output
    name : of the model file
    Raises ModelError naming an operator that cannot be written in C.
    """
    code = _Code(graph, {"u": n_inputs, "state": n_state})
    for node in graph.nodes:
        try:
            _emitter(node.kind)(code, node)
        except (KeyError, ValueError, IndexError):
            raise ModelError(
                f"{name}: its graph has {node.kind[:40]} in a form that is not written in C; "
                "models by this version of o2train fit are"
            ) from None
    code.loop(n_state, f"state[i] = {code.use('next_state')}[i];")
    head = "void o2_model_step(const float u[], float state[], float *predicted)"
    last = f"    *predicted = {code.use(prediction)}[0];"
    return "\n".join(
        [_HEAD.format(name=name), *code.constants, head, "{", *code.lines, last, "}", ""]
    )


def _emitter(kind: str) -> Callable[[_Code, Node], None]:
    if kind in _ELEMENTWISE:
        return _elementwise
    return {"Gemm": _gemm, "Concat": _concat, "ReduceSum": _sum, "Slice": _slice}[kind]


def _elementwise(code: _Code, node: Node) -> None:
    names = [code.use(name) for name in node.inputs]
    widths = [code.widths[name] for name in node.inputs]
    width = max(widths)
    if not {1, width} >= set(widths):
        raise ValueError(node.kind)
    at = [f"{own}[{'0' if w == 1 else 'i'}]" for own, w in zip(names, widths, strict=True)]
    out = code.result(node.outputs[0], width)
    code.loop(width, f"{out}[i] = {_ELEMENTWISE[node.kind].format(*at)};")


def _gemm(code: _Code, node: Node) -> None:
    if not node.whole.get("transB") or node.whole.get("transA"):
        raise ValueError(node.kind)
    x, weights, bias = (code.use(name) for name in node.inputs)
    columns = code.widths[node.inputs[0]]
    rows = code.given[node.inputs[1]].size // columns
    out = code.result(node.outputs[0], rows)
    code.loop(
        rows,
        f"float sum = {bias}[i];\n"
        f"        for (uint16_t j = 0U; j < {columns}U; j++) {{\n"
        f"            sum += {weights}[(i * {columns}U) + j] * {x}[j];\n"
        f"        }}\n        {out}[i] = sum;",
    )


def _concat(code: _Code, node: Node) -> None:
    names = [code.use(name) for name in node.inputs]
    widths = [code.widths[name] for name in node.inputs]
    out, at = code.result(node.outputs[0], sum(widths)), 0
    for own, width in zip(names, widths, strict=True):
        code.loop(width, f"{out}[i + {at}U] = {own}[i];")
        at += width


def _sum(code: _Code, node: Node) -> None:
    if code.given[node.inputs[1]].tolist() != [1]:  # of a row alone
        raise ValueError(node.kind)
    source, width = code.use(node.inputs[0]), code.widths[node.inputs[0]]
    out = code.result(node.outputs[0], 1)
    code.lines.append(f"    {out}[0] = 0.0f;")
    code.loop(width, f"{out}[0] += {source}[i];")


def _slice(code: _Code, node: Node) -> None:
    begin, end = (int(code.given[name].item()) for name in node.inputs[1:3])
    source = code.use(node.inputs[0])
    begin, end, _ = slice(begin, end).indices(code.widths[node.inputs[0]])
    out = code.result(node.outputs[0], end - begin)
    code.loop(end - begin, f"{out}[i] = {source}[i + {begin}U];")
