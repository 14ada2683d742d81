"""Several trainings of one shape as one network whose output is their mean.

The members stand side by side in wider layers that are block-diagonal, so the mean is a NARX like
any other, and what it feeds back is the mean. Errors of members that differ by their random start
alone partly cancel.
Source: Perrone and Cooper, When networks disagree: ensemble methods for hybrid neural networks
(1993); the shared feedback is our own choice, because it keeps one state.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from monitor.base.types import FloatArray
from training.narx.network import Spec, layers, linear_path


def committee(spec: Spec, members: Sequence[FloatArray]) -> tuple[Spec, FloatArray]:
    """Return shape and weights of the mean of ``members``, weights of the shape ``spec``.

    Raises ValueError if there is no member.
    """
    if not members:
        raise ValueError("a committee needs members")
    count = len(members)
    stacks = [layers(spec, weights) for weights in members]
    parts: list[FloatArray] = []
    for depth in range(len(spec.hidden) + 1):
        matrices = [stack[depth][0] for stack in stacks]
        biases = [stack[depth][1] for stack in stacks]
        if depth == len(spec.hidden):  # the mean; without hidden layers of the same regressor
            joined = np.concatenate(matrices, axis=1) / count if depth else sum(matrices) / count
            bias = np.mean(biases, axis=0)
        else:
            joined = block_diag(*matrices) if depth else np.concatenate(matrices)
            bias = np.concatenate(biases)
        parts += [np.ravel(joined), bias]
    if spec.linear_path:
        parts.append(np.mean([linear_path(spec, weights) for weights in members], axis=0))
    wide = replace(spec, hidden=tuple(n * count for n in spec.hidden))
    return wide, np.concatenate(parts)
