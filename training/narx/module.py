"""The network in torch: the study's first-order algorithms get their gradient from its autograd.

Levenberg–Marquardt has compiled derivatives; the tests hold these to torch's.
"""

from itertools import pairwise

import torch

from monitor.base.types import FloatArray
from training.narx.algorithms.objectives import OneStep
from training.narx.network import Spec

torch.set_num_threads(1)  # trainings run side by side, and sums have one order


class NarxModule(torch.nn.Module):
    """A NARX of the shape ``spec``, from regressors (n, n_regressors) to predictions (n,).

    weights : (n_weights,), in the order of ``network.layers``
    """

    def __init__(self, spec: Spec, weights: FloatArray) -> None:
        super().__init__()
        self.spec = spec
        self.weights = torch.nn.Parameter(torch.tensor(weights))

    def forward(self, regressors: torch.Tensor) -> torch.Tensor:
        """Return the unclipped one-step predictions."""
        at, values, sizes = 0, regressors, self.spec.sizes
        for below, width in pairwise(sizes):
            values = torch.tanh(values) if at else values
            bias_at = at + below * width
            matrix = self.weights[at:bias_at].reshape(width, below)
            at = bias_at + width
            values = values @ matrix.T + self.weights[bias_at:at]
        path = regressors @ self.weights[at:] if self.spec.linear_path else 0.0
        return values[:, 0] + path


class OneStepByTorch(OneStep):
    """The one-step error with its gradient."""

    def gradient(self, weights: FloatArray) -> tuple[float, FloatArray]:
        """Return the cost and its gradient (n_weights,)."""
        module = NarxModule(self.spec, weights)
        error = module(torch.from_numpy(self.regressors)) - torch.from_numpy(self.target)
        cost = torch.from_numpy(self.weight) @ error**2 / self.weight.sum()
        (found,) = torch.autograd.grad(cost, module.weights)
        return float(cost.detach()), found.numpy()
