"""The NARX as an ONNX graph with its card, and the file of any graph.

State: for every lag, newest first, the scaled inputs and then the output in model units, so that
one slice shifts it. The matrix products are Gemm with the batch as rows, which gives the same bits
for every batch size on onnxruntime's CPU provider; sums and batched products do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from monitor.base.errors import ModelError
from monitor.base.files.outputs import replaced, write_bytes
from monitor.base.types import FloatArray
from monitor.model import model_file
from monitor.model.card import USUAL_PREDICTION, ModelCard, StateLayout, prediction_name
from monitor.model.step import LAMBDA_MAX, PHI_MAX, Model
from training.narx.network import Spec, layers, linear_path, widened
from training.recordings.samples.scaling import Scaling

OPSET = 17
IR_VERSION = 8


@dataclass(frozen=True, slots=True)
class Network:
    """A trained NARX with its scaling, all that its graph contains."""

    spec: Spec
    weights: FloatArray
    scaling: Scaling
    transform: str
    inputs: tuple[str, ...]

    @property
    def state_layout(self) -> StateLayout:
        """Where the output history lies in the state."""
        k, memory = self.spec.n_inputs, self.spec.memory
        return StateLayout((k + 1) * memory, k, k + 1, memory)

    @property
    def sees_newest(self) -> bool:
        """Whether the inputs of the tick itself enter."""
        return self.spec.boxes[0][0] == 0

    def folded_layers(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return the layers over the graph's regressor, output in model units.

        The regressor is the state, before it the newest scaled inputs if lag 0 is used. Scaled
        inputs of the graph run from -1 to 1 over the clipping range. A linear path is part of the
        last layer, which then takes the regressor beside the last hidden layer.
        """
        spec, scale = self.spec, self.scaling
        stack = [(w.copy(), b.copy()) for w, b in layers(spec, self.weights)]
        stack[0] = self._folded(*stack[0])
        if spec.linear_path:
            w, b = stack[-1]
            path, offset = self._folded(linear_path(spec, self.weights)[None], np.zeros(1))
            stack[-1] = (np.concatenate([w, path], axis=1), b + offset)
        last, offset = stack[-1]
        stack[-1] = (last * scale.y_std, offset * scale.y_std + scale.y_mean)
        return stack

    def _folded(self, matrix: FloatArray, bias: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a matrix over the training's regressor as one over the graph's."""
        scale, k, memory = self.scaling, self.spec.n_inputs, self.spec.memory
        single = Spec(k, memory, (), 0)  # one place for each lag from 0 on
        wide = widened(matrix, self.spec, single)
        inputs, outputs = np.split(wide, [(memory + 1) * k], axis=1)
        inputs, outputs = inputs.reshape(-1, memory + 1, k), outputs[:, :, None]
        middle, half = self.input_range
        bias = bias + (inputs * ((middle - scale.u_mean) / scale.u_std)).sum(axis=(1, 2))
        bias -= outputs.sum(axis=(1, 2)) * scale.y_mean / scale.y_std
        inputs = inputs * (half / scale.u_std)
        past = np.concatenate([inputs[:, 1:], outputs / scale.y_std], axis=2)
        parts = [inputs[:, 0]] if self.sees_newest else []
        return np.concatenate([*parts, past.reshape(len(matrix), -1)], axis=1), bias

    @property
    def input_range(self) -> tuple[FloatArray, FloatArray]:
        """Middle and half width (k,) of the range to which inputs are clipped."""
        low, high = self.scaling.u_low, self.scaling.u_high
        return (high + low) / 2, (high - low) / 2


class Graph:
    """Nodes and constants under construction; every method returns the new tensor's name."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def add(self, kind: str, operands: Sequence[Any], output: str = "", **attributes: Any) -> str:
        """Add a node with one output, by default with a name of its own.

        operands : names of tensors, or constants: integers in a list, others float32
        """
        output = output or f"n{len(self.nodes)}"
        names = [x if isinstance(x, str) else self._constant(x) for x in operands]
        self.nodes.append(helper.make_node(kind, names, [output], **attributes))
        return output

    def take(self, source: str, start: int, stop: int, output: str = "") -> str:
        """Add the columns start .. stop - 1 of ``source``."""
        return self.add("Slice", [source, [start], [stop], [1]], output)

    def _constant(self, value: Any) -> str:
        name, dtype = f"c{len(self.constants)}", np.int64 if isinstance(value, list) else np.float32
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name


def build(network: Network) -> onnx.ModelProto:
    """Return the graph ``step``, float32, without a card."""
    graph, spec, size = Graph(), network.spec, network.state_layout.size
    middle, half = network.input_range
    mapped = graph.add("Gemm", ["u", np.diag(1.0 / half), -middle / half], transB=1)
    u_scaled = graph.add("Clip", [mapped, -1.0, 1.0])
    regressor = "state"
    if network.sees_newest:
        regressor = graph.add("Concat", [u_scaled, "state"], axis=1)
    *inner, (w, b) = network.folded_layers()
    x = regressor
    for matrix, bias in inner:
        x = graph.add("Tanh", [graph.add("Gemm", [x, matrix, bias], transB=1)])
    if spec.linear_path:
        x = graph.add("Concat", [x, regressor], axis=1)
    total = graph.add("Gemm", [x, w, b], transB=1)
    y = graph.add("Clip", [total, network.scaling.y_low, network.scaling.y_high])
    lambda_nodes(graph, network.transform, y)
    kept = graph.take("state", 0, size - spec.n_inputs - 1)
    graph.add("Concat", [u_scaled, y, kept], "next_state", axis=1)
    return finished(graph, spec.n_inputs, size)


def lambda_nodes(graph: Graph, transform: str, y: str) -> None:
    """Add the graph's output ``lambda_hat`` for ``y`` in model units."""
    if transform == "phi":
        readable = graph.add("Clip", [y, 1.0 / LAMBDA_MAX, PHI_MAX])
        graph.add("Reciprocal", [readable], "lambda_hat")
    else:
        graph.add("Identity", [y], "lambda_hat")


def finished(graph: Graph, n_inputs: int, size: int) -> onnx.ModelProto:
    """Return the checked graph ``step`` of these nodes."""

    def array(name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])

    step = helper.make_graph(
        graph.nodes,
        "step",
        [array("u", n_inputs), array("state", size)],
        [array("lambda_hat", 1), array("next_state", size)],
        graph.constants,
    )
    model = helper.make_model(
        step,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="o2-monitor",
    )
    onnx.checker.check_model(model)
    return model


def write(path: Path | str, model: onnx.ModelProto, card: ModelCard) -> None:
    """Write a graph and its card to one file."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    name_prediction(model, prediction_name(card.output.name))
    write_bytes(path, file_content(model, card))


def name_prediction(model: onnx.ModelProto, name: str) -> None:
    """Name the prediction of a graph after the model's output."""
    for output in model.graph.output:
        if output.name == USUAL_PREDICTION:
            output.name = name
    for node in model.graph.node:
        for names in (node.input, node.output):
            names[:] = [name if each == USUAL_PREDICTION else each for each in names]


def file_content(model: onnx.ModelProto, card: ModelCard) -> bytes:
    """Return the content of a model file, whose card holds the sha256 of its graph."""
    model.ClearField("metadata_props")
    graph = model_file.graph_sha256(model.SerializeToString())
    told = model_file.metadata_of(replace(card, graph_sha256=graph).to_json())
    helper.set_model_props(model, told)
    return model.SerializeToString()


def update_card(path: Path | str, card: ModelCard, out: Path | str | None = None) -> None:
    """Rewrite the card of a model file, nothing else; it is replaced in one step.

    out : where to write the model with the new card; default ``path``
    Raises ModelError if the file is not ONNX or the card does not fit its graph.
    """
    Model.load(path)  # raises if the file is no model
    model = onnx.load(str(path))
    with replaced(out or path) as begun:
        begun.write_bytes(file_content(model, card))
        try:
            Model.load(begun)
        except ModelError as error:
            raise ModelError(f"{path}: the new card does not fit: {error}") from None
