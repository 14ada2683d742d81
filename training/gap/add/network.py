"""Effects become part of a network's file: what they change at the sensor, added to its output.

That is the chain with the effects minus the chain without. The network's own nodes stay as they
are, under a prefix. The state is the network's, then the effects' part of the newest output, then
what the chains remember. The newest output in the state is the whole one, so that the monitor
forces and reads it as in any model; the network gets back what remains without the effects' part.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import onnx

from monitor.base.errors import ModelError
from monitor.model.card import ModelCard, TrainingRecording
from monitor.model.step import Model
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.graph.chain_difference import ChainDifference
from training.greybox.graph.effect_inputs import Ranges, channel_of
from training.narx.export import Graph, finished, lambda_nodes, write

OWN: Final = "network_"  # prefix of the network's nodes in a file with effects


def add(
    model: Path | str,
    added: Sequence[ModelEffect],
    chain: Constants,
    out: Path | str,
    *,
    ranges: Ranges,
    recordings: Sequence[TrainingRecording],
) -> ModelCard:
    """Write ``model`` with effects beside its output to ``out``; return its card.

    chain : constants of the chain that the effects were fitted in
    ranges : low and high of every signal present in the drives of the fit; an optional signal
        that is not among them was not there, and the effect takes its own default for it
    recordings : what the effects were fitted to
    Effects that the model has already stay, in the chain of the new constants.
    Raises ModelError if the model is not a network of lambda, or a signal is missing.
    """
    card = Model.load(model).card
    if card.kind != "narx" or card.transform != "phi":
        raise ModelError(f"{model}: a network of lambda is wanted, to add effects to its output")
    older = [ModelEffect.from_card(each) for each in card.effects]
    difference = ChainDifference.beside(card, [*older, *added], chain, ranges)
    inputs = tuple(dict.fromkeys((*card.input_names, *difference.inputs)))
    own, size, n_inputs = _network_of(model, card)
    entries = [each.to_card(recordings) for each in difference.effects[len(older) :]]
    known = {each.name: each for each in card.inputs}  # keep what the network was trained on
    new = replace(
        card,
        inputs=tuple(known.get(n) or channel_of(n, None, ranges.get(n)) for n in inputs),
        state=replace(card.state, size=size + 1 + difference.n_states),
        recordings=tuple({r.sha256: r for r in (*card.recordings, *recordings)}.values()),
        effects=(*card.effects, *entries),
        structure=dict(card.structure)
        | {"chain": difference.to_card(), "network_inputs": n_inputs, "network_state": size},
    )
    write(out, _graph(own, new, difference), new)
    return new


def _network_of(model: Path | str, card: ModelCard) -> tuple[onnx.GraphProto, int, int]:
    """Return the network's own nodes under the prefix, its state's size and number of inputs."""
    graph = onnx.load(str(model)).graph
    if not card.effects:
        return _prefixed(graph), card.state.size, len(card.inputs)
    try:
        size, n_inputs = (int(card.structure[f"network_{of}"]) for of in ("state", "inputs"))
    except KeyError:
        raise ModelError(f"{model}: has effects in an older form, take the model before") from None
    own = onnx.GraphProto()
    own.node.extend(n for n in graph.node if n.name.startswith(OWN))
    own.initializer.extend(c for c in graph.initializer if c.name.startswith(OWN))
    return own, size, n_inputs


def _prefixed(graph: onnx.GraphProto) -> onnx.GraphProto:
    """Return the nodes with all names under the prefix."""
    own = onnx.GraphProto()
    own.CopyFrom(graph)
    for node in own.node:
        node.name = f"{OWN}{node.output[0]}"
        for names in (node.input, node.output):
            names[:] = [f"{OWN}{each}" for each in names]
    for constant in own.initializer:
        constant.name = f"{OWN}{constant.name}"
    return own


def _graph(own: onnx.GraphProto, card: ModelCard, difference: ChainDifference) -> onnx.ModelProto:
    """Return the graph of the network with the difference, float32, without a card."""
    graph, names, read = Graph(), card.input_names, difference.inputs
    size, at = int(card.structure["network_state"]), card.state.output_start
    signals = {n: graph.take("u", i, i + 1) for i, n in enumerate(names) if n in read}
    chains = graph.take("state", size + 1, card.state.size)
    more, chains = difference.nodes(graph, signals, chains)
    whole, part = graph.take("state", at, at + 1), graph.take("state", size, size + 1)
    left = graph.add("Clip", [graph.add("Sub", [whole, part]), *card.output_limits])
    graph.take("u", 0, int(card.structure["network_inputs"]), f"{OWN}u")
    _with_output(graph, card, "state", left, f"{OWN}state")
    graph.nodes.extend(own.node)
    graph.constants.extend(own.initializer)
    ahead = f"{OWN}next_state"
    y = graph.take(ahead, at, at + 1)
    whole = graph.add("Clip", [graph.add("Add", [y, more]), *card.output_limits])
    lambda_nodes(graph, card.transform, whole)
    network = _with_output(graph, card, ahead, whole)
    part = graph.add("Sub", [whole, y])
    graph.add("Concat", [network, part, chains], "next_state", axis=1)
    return finished(graph, len(names), card.state.size)


def _with_output(graph: Graph, card: ModelCard, state: str, y: str, name: str = "") -> str:
    """Add the network's part of a state, with another newest output."""
    size, at = int(card.structure["network_state"]), card.state.output_start
    before, after = graph.take(state, 0, at), graph.take(state, at + 1, size)
    return graph.add("Concat", [before, y, after], name, axis=1)
