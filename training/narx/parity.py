"""The same free run three times: numpy in float64, torch and ONNX in float32."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.step import LAMBDA_MAX, PHI_MAX, Model
from training.narx.export import Network
from training.narx.network import simulate
from training.recordings.samples.transforms import apply

TOLERANCE = 2e-3  # of the output's standard deviation, float32 against float64 over a free run
SHORT_RUN = 100  # samples that must agree; rounding adds up in outputs that integrate


class NetworkStep(nn.Module):
    """The graph ``step`` as a torch module: (u, state) to (output, next state)."""

    def __init__(self, network: Network, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.network = network
        for i, (w, b) in enumerate(network.folded_layers()):
            self.register_parameter(f"w{i}", nn.Parameter(torch.tensor(w, dtype=dtype)))
            self.register_parameter(f"b{i}", nn.Parameter(torch.tensor(b, dtype=dtype)))
        self.depth = len(network.folded_layers())
        gain, offset = network.input_map()
        self.register_buffer("gain", torch.tensor(gain, dtype=dtype))
        self.register_buffer("offset", torch.tensor(offset, dtype=dtype))

    def forward(self, u: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the output (batch, 1) and the next state for ``u`` (batch, n_inputs)."""
        net = self.network
        columns = list(u.unbind(1))
        for t in net.transforms:
            i, j = net.inputs.index(t["numerator"]), net.inputs.index(t["denominator"])
            below = u[:, j].clamp(min=t["denominator_minimum"])
            columns[i] = (t["factor"] * u[:, i] / below).clamp(0.0, t["maximum"])
        gain, offset = self.get_buffer("gain"), self.get_buffer("offset")
        scaled = (torch.stack(columns, 1) * gain + offset).clamp(-1.0, 1.0)
        x = regressor = torch.cat([scaled, state], 1) if net.sees_newest else state
        for i in range(self.depth):
            if net.spec.linear_path and i == self.depth - 1:
                x = torch.cat([x, regressor], 1)
            x = x @ self.get_parameter(f"w{i}").T + self.get_parameter(f"b{i}")
            x = torch.tanh(x) if i < self.depth - 1 else x
        y = x.clamp(net.scaling.y_low, net.scaling.y_high)
        output = 1.0 / y.clamp(1.0 / LAMBDA_MAX, PHI_MAX) if net.transform == "phi" else y
        kept = state[:, : state.shape[1] - net.spec.n_inputs - 1]
        return output, torch.cat([scaled, y, kept], 1)


@dataclass(frozen=True, slots=True)
class Parity:
    """Largest differences over a free run, in model units."""

    samples: int
    onnx_numpy: float
    torch_numpy: float
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
    module = NetworkStep(network)
    other = np.empty(n)
    state = torch.zeros((1, model.card.state.size))
    inputs = torch.tensor(u, dtype=torch.float32)
    limited = np.clip(y, scale.y_low, scale.y_high)
    with torch.no_grad():
        for k in range(n):
            model.step(u[k])
            _, state = module(inputs[k : k + 1], state)
            if k < first:
                model.state[0, newest] = state[0, newest] = float(limited[k])
            graph[k], other[k] = model.state[0, newest], float(state[0, newest])
    tolerance = TOLERANCE * scale.y_std
    strict = n if network.transform == "phi" else min(n, first + SHORT_RUN)
    result = Parity(
        n - first,
        float(np.abs(graph[first:] - reference).max()),
        float(np.abs(other[first:] - reference).max()),
        tolerance,
    )
    off = [
        float(np.abs(run[first:strict] - reference[: strict - first]).max())
        for run in (graph, other)
    ]
    if not max(off) <= tolerance:
        raise ModelError(
            f"{path}: free runs differ by {off[0]:.2g} (ONNX) and {off[1]:.2g} (torch) from "
            f"numpy within {strict - first} samples, tolerance {tolerance:.2g}"
        )
    return result
