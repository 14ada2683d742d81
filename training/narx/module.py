"""The network in torch: the study's first-order algorithms get their gradient from its autograd.

Levenberg–Marquardt has compiled derivatives; the tests hold these to torch's.
"""

import torch

from monitor.base.types import FloatArray
from training.narx.network import Spec, forward

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
        predicted: torch.Tensor = forward(self.spec, self.weights, regressors, torch.tanh)
        return predicted


class OneStepByTorch:
    """The mean squared one-step error, weighted, with its gradient by torch.

    regressors, target, weight : shapes (n, n_regressors), (n,), (n,)
    """

    def __init__(
        self, spec: Spec, regressors: FloatArray, target: FloatArray, weight: FloatArray
    ) -> None:
        self._spec = spec
        self._data = [torch.from_numpy(each) for each in (regressors, target, weight)]

    def cost(self, weights: FloatArray) -> float:
        """Return the error."""
        with torch.no_grad():
            return float(self._error(NarxModule(self._spec, weights)))

    def gradient(self, weights: FloatArray) -> tuple[float, FloatArray]:
        """Return the error and its gradient (n_weights,)."""
        module = NarxModule(self._spec, weights)
        error = self._error(module)
        (found,) = torch.autograd.grad(error, module.weights)
        return float(error.detach()), found.numpy()

    def _error(self, module: NarxModule) -> torch.Tensor:
        regressors, target, weight = self._data
        return weight @ (module(regressors) - target) ** 2 / weight.sum()
