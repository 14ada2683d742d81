"""A network trained again in its old shape, with the effects' change of phi as one more input.

The first start is the old network, to which the new input means nothing yet; others are random.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from training.gap.add.network_graph import DIFFERENCE
from training.greybox.graph.chain_difference import ChainDifference
from training.jobs import Progress
from training.narx.export import Network
from training.narx.network import Layers, Spec, layers, linear_path
from training.narx.search.stability import Contraction
from training.narx.search.stages import Trained, train
from training.narx.search.starts import choose, committees
from training.narx.search.structure import FIRST_DECAY
from training.narx.work import Work
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared
from training.recordings.samples.rows import hold
from training.recordings.samples.scaling import Scaling

RANDOM_STARTS = 2


def with_difference(recording: Recording, difference: ChainDifference) -> Recording:
    """Return the recording with the difference as its last column, NaN where an input is not good.

    Without effects it is zero, whatever the inputs. Raises RecordingError if it lacks a signal.
    """
    n = len(recording.values)
    values = np.zeros(n)
    if difference.entries:
        columns = {name: recording.column(name) for name in difference.inputs}
        good = np.all([np.isfinite(each) for each in columns.values()], axis=0)
        values = difference.values({name: hold(each) for name, each in columns.items()})
        values = np.where(good, values, np.nan)
    return replace(
        recording,
        names=(*recording.names, DIFFERENCE),
        values=np.column_stack([recording.values, values]),
        quality=np.column_stack([recording.quality, np.zeros(n, np.uint8)]),
    )


def train_again(
    data: Prepared,
    card: ModelCard,
    network: Network,
    seed: int,
    work: Work,
    progress: Progress,
) -> tuple[Trained, Contraction]:
    """Return the best training of the old network's shape, and how fast it forgets.

    card, network : of the old model; the last input of ``data`` is the new one
    progress : is told after every epoch how far it is
    Raises UsageError if the work ended before the first epoch.
    """
    spec = spec_of(card, network, data)
    begins = [*old_weights(card, network, spec, data.scaling), *[None] * RANDOM_STARTS]
    decay = FIRST_DECAY[0] if spec.linear_path else 0.0
    trained = list[Trained]()
    for number, weights in enumerate(begins):
        if work.is_over():
            break
        part = work.up_to(work.left / (len(begins) - number))
        told = _told(progress, f"training anew, start {number + 1} of {len(begins)}")
        trained.append(
            train(data, spec, seed + 1000 * number, part, told, decay=decay, weights=weights)
        )
        work.join([part])
    trained = [each for each in trained if np.isfinite(each.score)]
    if not trained:
        raise UsageError("the budget ended before the first epoch of the retraining")
    if card.structure.get("members", 1) > 1:  # another number may be the best of them now
        trained += committees(data, trained)
    best, gap = choose(data, trained, seed)
    return trained[best], gap


def _told(progress: Progress, what: str) -> Callable[[int, int, float], None]:
    return lambda horizon, _, score: progress(f"{what}, horizon {horizon}, free run {score:.3f}")


def spec_of(card: ModelCard, network: Network, data: Prepared) -> Spec:
    """Return the shape of one training of a model, for inputs and scaling of ``data``."""
    members, structure = _members(card), card.structure
    y_min, y_max = data.scaling.y_scaled_limits
    return Spec(
        n_inputs=len(data.inputs),
        lags=int(structure.get("output_lags", card.lags)),
        hidden=tuple(n // members for n in card.layers),
        input_lag_start=card.input_lag_start,
        y_min=y_min,
        y_max=y_max,
        input_boxes=tuple((int(a), int(b)) for a, b in structure.get("input_boxes", ())),
        linear_path=network.spec.linear_path,
    )


def _members(card: ModelCard) -> int:
    return int(card.structure.get("members", 1)) if card.layers else 1


def old_weights(
    card: ModelCard, network: Network, spec: Spec, scaling: Scaling
) -> list[FloatArray]:
    """Return weights of the shape ``spec`` for each training whose mean the old network is.

    They predict what it does, whatever the last input is.
    """
    path = linear_path(network.spec, network.weights) if spec.linear_path else None
    found = []
    for stack in _apart(layers(network.spec, network.weights), _members(card)):
        stack[0] = _rescaled(network, spec, scaling, *stack[0])
        w, b = stack[-1]
        tail = np.empty(0)
        if path is not None:
            direct, more = _rescaled(network, spec, scaling, path[None], np.zeros(1))
            b, tail = b + more, direct[0] / scaling.y_std
        stack[-1] = (w / scaling.y_std, (b - scaling.y_mean) / scaling.y_std)
        found.append(np.concatenate([*(x.ravel() for pair in stack for x in pair), tail]))
    return found


def _apart(stack: Layers, members: int) -> list[Layers]:
    """Return the layers of each member; a committee is block-diagonal and a mean at the end."""
    apart: list[Layers] = []
    for i in range(members):
        own: Layers = []
        for depth, (w, b) in enumerate(stack):
            rows, columns = len(w) // members, w.shape[1] // members
            last = depth == len(stack) - 1
            up = slice(None) if last else slice(i * rows, (i + 1) * rows)
            along = slice(i * columns, (i + 1) * columns) if depth else slice(None)
            own.append((w[up, along] * (members if last else 1), b[up]))
        apart.append(own)
    return apart


def _rescaled(
    network: Network, spec: Spec, scaling: Scaling, matrix: FloatArray, bias: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a matrix over the old network's regressor as one over that of ``spec``."""
    old, k = network.spec, network.spec.n_inputs
    first, n_lags = old.input_lag_start, len(old.boxes)
    by_lag = np.zeros((len(matrix), old.memory + 1, k))
    by_lag[:, first:] = matrix[:, : n_lags * k].reshape(-1, n_lags, k)
    boxed = np.stack([by_lag[:, a:b].sum(axis=1) for a, b in spec.boxes], axis=1)
    outputs = matrix[:, n_lags * k : n_lags * k + spec.lags]
    middle, half = network.scaling.u_mean, network.scaling.u_std
    mean, std = scaling.u_mean[:k], scaling.u_std[:k]
    bias = bias + (boxed * ((mean - middle) / half)).sum(axis=(1, 2))
    bias += outputs.sum(axis=1) * scaling.y_mean
    nothing = np.zeros((len(matrix), len(spec.boxes), 1))
    inputs = np.concatenate([boxed * (std / half), nothing], axis=2).reshape(len(matrix), -1)
    return np.concatenate([inputs, outputs * scaling.y_std], axis=1), bias
