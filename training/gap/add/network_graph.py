"""A network with effects: graphs of two forms, and the network taken out of a file again.

Added to the output: the state is the network's own as ``export`` has it, then the effects' part of
the newest output, then what the chains remember. The newest output in the state is the whole one,
so that the monitor forces and reads it as in any model, and the network feeds back what remains of
it without the effects' part.
As an input: the network's own state, then the chains'.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import onnx
from onnx import numpy_helper

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard, StateLayout
from monitor.model.step import Model
from training.greybox.graph.chain_difference import ChainDifference
from training.narx.export import (
    Graph,
    Network,
    finished,
    lambda_nodes,
    network_nodes,
    next_nodes,
    write,
)
from training.narx.network import Spec
from training.recordings.samples.scaling import Scaling

DIFFERENCE: Final = "chain_difference"  # the network's last input after a retraining
TO_OUTPUT: Final = "added to the output"
AS_INPUT: Final = "input of the retrained network"


@dataclass(frozen=True, slots=True)
class NetworkWithEffects:
    """A network and the effects' change of the chain, in one of the two forms."""

    form: str
    network: Network
    difference: ChainDifference
    inputs: tuple[str, ...]  # of the graph, the network's own first

    @property
    def state_layout(self) -> StateLayout:
        """Size of the state, and where the output lies in it."""
        own = self.network.state_layout
        parts = 1 if self.form == TO_OUTPUT else 0
        return replace(own, size=own.size + parts + self.difference.n_states)

    @property
    def memory(self) -> int:
        """Samples after which all but the network has forgotten how it began."""
        return self.difference.memory

    def build(self) -> onnx.ModelProto:
        """Return the graph ``step``, float32, without a card."""
        graph = Graph()
        signals = {
            name: graph.take("u", i, i + 1, f"signal_{name}")
            for i, name in enumerate(self.inputs)
            if name in self.difference.inputs
        }
        size = self.state_layout.size
        chains = graph.take("state", size - self.difference.n_states, size, "chains")
        more, chains = self.difference.nodes(graph, signals, chains)
        nodes = self._added if self.form == TO_OUTPUT else self._retrained
        nodes(graph, more, chains)
        return finished(graph, len(self.inputs), size)

    def _added(self, graph: Graph, more: str, chains: str) -> None:
        network, size = self.network, self.network.state_layout.size
        at, k = network.state_layout.output_start, network.spec.n_inputs
        whole = graph.take("state", at, at + 1, "old_output")
        part = graph.take("state", size, size + 1, "old_part")
        own = _limited(graph, network, graph.add("Sub", [whole, part], "without_part"), "own")
        before, after = (
            graph.take("state", a, b, f"from_{a}") for a, b in ((0, at), (at + 1, size))
        )
        state = graph.add("Concat", [before, own, after], "network_state", axis=1)
        u_scaled, y = network_nodes(graph, network, graph.take("u", 0, k, "network_u"), state)
        whole = _limited(graph, network, graph.add("Add", [y, more], "sum"), "whole")
        lambda_nodes(graph, network.transform, whole)
        part = graph.add("Sub", [whole, y], "part")
        next_nodes(graph, network, u_scaled=u_scaled, y=whole, state=state, more=[part, chains])

    def _retrained(self, graph: Graph, more: str, chains: str) -> None:
        network, size = self.network, self.network.state_layout.size
        others = graph.take("u", 0, network.spec.n_inputs - 1, "others")
        u = graph.add("Concat", [others, more], "network_u", axis=1)
        state = graph.take("state", 0, size, "network_state")
        u_scaled, y = network_nodes(graph, network, u, state)
        lambda_nodes(graph, network.transform, y)
        next_nodes(graph, network, u_scaled=u_scaled, y=y, state=state, more=[chains])

    def save(self, path: Path | str, card: ModelCard) -> None:
        """Write graph and card to one file."""
        write(path, self.build(), card)

    def split(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the network's inputs (n, k) and the difference (n,) for ``u`` (n, n_inputs)."""
        signals = {name: u[:, i] for i, name in enumerate(self.inputs)}
        difference = signals[DIFFERENCE] = self.difference.values(signals)
        return np.column_stack([signals[name] for name in self.network.inputs]), difference

    def whole(self, own: FloatArray, difference: FloatArray) -> FloatArray:
        """Return the model's output (n,) in model units for the network's output (n,)."""
        if self.form != TO_OUTPUT:
            return own
        return np.clip(own + difference, self.network.scaling.y_low, self.network.scaling.y_high)


def _limited(graph: Graph, network: Network, y: str, name: str) -> str:
    limits = [
        graph.constant(f"{name}_low", network.scaling.y_low),
        graph.constant(f"{name}_high", network.scaling.y_high),
    ]
    return graph.add("Clip", [y, *limits], f"{name}_limited")


def network_of(path: Path | str) -> Network:
    """Return the network of a model file, its inputs scaled to -1 .. 1, its output not at all.

    What was added to its output is left out.
    Raises ModelError if the file is not a network of ``export``, or was retrained with effects.
    """
    card = Model.load(path).card
    if card.kind != "narx":
        raise ModelError(f"{path}: a {card.kind} model, a narx is wanted")
    if card.structure.get("form") == AS_INPUT:
        raise ModelError(f"{path}: was retrained with effects, take the model before them")
    found = {c.name: numpy_helper.to_array(c) for c in onnx.load(str(path)).graph.initializer}
    values = {
        name: each.astype(np.float64) for name, each in found.items() if each.dtype.kind == "f"
    }
    try:
        half = 1.0 / np.diag(values["u_gain"])
        middle = -values["u_offset"] * half
        stack = [(values[f"w{i}"], values[f"b{i}"]) for i in range(len(card.layers) + 1)]
    except KeyError as error:
        raise ModelError(f"{path}: the graph has no {error}, it is not o2train's") from None
    k, memory = len(half), card.lags
    low, high = card.output_limits
    has_path = bool(card.layers) and stack[-1][0].shape[1] > card.layers[-1]
    spec = Spec(
        n_inputs=k,
        lags=memory,
        hidden=card.layers,
        input_lag_start=card.input_lag_start,
        y_min=low,
        y_max=high,
        linear_path=has_path,
    )
    scaling = Scaling(
        u_mean=middle,
        u_std=half,
        u_low=middle - half,
        u_high=middle + half,
        y_mean=0.0,
        y_std=1.0,
        y_low=low,
        y_high=high,
    )
    inputs = card.input_names[:k]
    return Network(
        spec=spec,
        weights=_weights(spec, stack),
        scaling=scaling,
        transform=card.transform,
        transforms=card.transforms,
        inputs=inputs,
    )


def _weights(spec: Spec, stack: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Return the graph's matrices as one vector over the training's regressor."""
    matrices, biases = [w for w, _ in stack], [b for _, b in stack]
    path = np.empty(0)
    if spec.linear_path:
        width = spec.hidden[-1]
        path = _by_boxes(spec, matrices[-1][:, width:])[0]
        matrices[-1] = matrices[-1][:, :width]
    matrices[0] = _by_boxes(spec, matrices[0])
    parts = [part.ravel() for pair in zip(matrices, biases, strict=True) for part in pair]
    return np.concatenate([*parts, path])


def _by_boxes(spec: Spec, matrix: FloatArray) -> FloatArray:
    """Return a matrix over the graph's regressor as one over the training's; boxes are lags."""
    k, newest = spec.n_inputs, spec.n_inputs * (spec.input_lag_start == 0)
    past = matrix[:, newest:].reshape(len(matrix), spec.memory, k + 1)
    inputs = past[:, :, :k].reshape(len(matrix), -1)
    return np.concatenate([matrix[:, :newest], inputs, past[:, :, k]], axis=1)
