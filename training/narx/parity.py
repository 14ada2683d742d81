"""The same free run twice: numpy in float64 and ONNX in float32."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from training.narx.export import Network
from training.narx.network import simulate
from training.recordings.samples.transforms import apply

TOLERANCE = 2e-3  # of the output's standard deviation, float32 against float64 over a free run
SHORT_RUN = 100  # samples that must agree; rounding adds up in outputs that integrate


@dataclass(frozen=True, slots=True)
class Parity:
    """Largest differences over a free run, in model units."""

    samples: int
    onnx_numpy: float
    tolerance: float


def parity(path: Path | str, network: Network, u: FloatArray, y: FloatArray) -> Parity:
    """Compare free runs over ``u`` (n, k) in physical units from the measured history.

    y : (n,) model units; the first ``memory`` samples start the run
    Raises ModelError if a difference exceeds the tolerance, over the whole run for lambda, which
    forgets, within 100 samples for other outputs.
    """
    spec, scale = network.spec, network.scaling
    n, first = len(u), spec.memory
    history = scale.scale_y(y[first - spec.lags : first])[::-1][None].copy()
    scaled = scale.scale_u(apply(network.transforms, network.inputs, u))
    reference = scale.unscale_y(
        simulate(
            spec,
            network.weights,
            u=scaled,
            start=np.array([first]),
            stop=np.array([n]),
            history=history,
        )
    )[first:]
    model = Model.load(path)
    newest = model.card.state.output_start
    graph = np.empty(n)
    limited = np.clip(y, scale.y_low, scale.y_high)
    for k in range(n):
        model.step(u[k])
        if k < first:
            model.state[0, newest] = limited[k]
        graph[k] = model.state[0, newest]
    tolerance = TOLERANCE * scale.y_std
    strict = n if network.transform == "phi" else min(n, first + SHORT_RUN)
    off = np.abs(graph[first:] - reference)
    if not off[: strict - first].max() <= tolerance:
        raise ModelError(
            f"{path}: free runs in ONNX and numpy differ by {off[: strict - first].max():.2g} "
            f"within {strict - first} samples, tolerance {tolerance:.2g}"
        )
    return Parity(n - first, float(off.max()), tolerance)
