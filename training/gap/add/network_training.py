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
from training.narx.network import Spec, layers, linear_path
from training.narx.search.mean import choose
from training.narx.search.stability import Contraction
from training.narx.search.stages import Trained, train
from training.narx.work import Work
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared
from training.recordings.samples.rows import hold
from training.recordings.samples.scaling import Scaling

RANDOM_STARTS = 2
DECAY = 1e-5  # of the weights of a network with a linear path


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
    begins = [old_weights(network, spec, data.scaling), *[None] * RANDOM_STARTS]
    decay = DECAY if spec.linear_path else 0.0
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
    chosen = choose(data, trained, seed, work, join=False)
    return chosen.model, chosen.gap


def _told(progress: Progress, what: str) -> Callable[[int, int, float], None]:
    return lambda horizon, _, score: progress(f"{what}, horizon {horizon}, free run {score:.3f}")


def spec_of(card: ModelCard, network: Network, data: Prepared) -> Spec:
    """Return the shape of a model, for inputs and scaling of ``data``."""
    structure = card.structure
    y_min, y_max = data.scaling.y_scaled_limits
    return Spec(
        n_inputs=len(data.inputs),
        lags=int(structure.get("output_lags", card.lags)),
        hidden=tuple(card.layers),
        input_lag_start=card.input_lag_start,
        y_min=y_min,
        y_max=y_max,
        input_boxes=tuple((int(a), int(b)) for a, b in structure.get("input_boxes", ())),
        linear_path=network.spec.linear_path,
    )


def old_weights(network: Network, spec: Spec, scaling: Scaling) -> FloatArray:
    """Return weights of the shape ``spec`` that predict what the old network does.

    They do whatever the last input is.
    """
    stack, tail = [(w.copy(), b) for w, b in layers(network.spec, network.weights)], np.empty(0)
    stack[0] = _rescaled(network, spec, scaling, *stack[0])
    w, b = stack[-1]
    if spec.linear_path:
        path = linear_path(network.spec, network.weights)[None]
        direct, more = _rescaled(network, spec, scaling, path, np.zeros(1))
        b, tail = b + more, direct[0] / scaling.y_std
    stack[-1] = (w / scaling.y_std, (b - scaling.y_mean) / scaling.y_std)
    return np.concatenate([*(x.ravel() for pair in stack for x in pair), tail])


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
