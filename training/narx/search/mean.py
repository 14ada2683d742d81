"""The choice among trainings, and their mean as one network, whatever their memories and widths.

Source: Perrone and Cooper, When networks disagree: ensemble methods for hybrid neural networks
(1993); the shared feedback is our own choice, because it keeps one state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from monitor.base.types import FloatArray
from training.narx.network import Spec, layers, linear_path, widened
from training.narx.search.stability import Contraction, contraction, settling
from training.narx.search.stages import Trained, with_less_feedback
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared

Member = tuple[Spec, FloatArray]  # shape and weights of one training


@dataclass(frozen=True, slots=True)
class NetworkChoice:
    """The trainings that may be the model, the model, how well it forgets."""

    starts: tuple[Trained, ...]
    model: Trained
    gap: Contraction

    @property
    def members(self) -> tuple[Trained, ...]:
        """Return the trainings whose mean the model is."""
        alone = tuple(t for t in self.starts if t.members == 1)
        return alone if self.model.members > 1 else (self.model,)

    @property
    def best_member(self) -> Trained:
        """Return the best of them."""
        return min(self.members, key=lambda t: t.score)


def choose(
    data: Prepared, trained: Sequence[Trained], seed: int, work: Work, join: bool
) -> NetworkChoice:
    """Return the best training, or the mean of all.

    If the data have a memory, as lambda has, only those that forget their history count; if none
    does, the best one is trained on with less feedback.
    join : the mean, unless it alone remembers
    """

    def forgets(t: Trained) -> bool:
        return contraction(data, t.spec, t.weights, seed).forgets

    finite = [t for t in trained if np.isfinite(t.score)] or list(trained[:1])
    if data.memory and np.isfinite(finite[0].score):
        best = min(finite, key=lambda t: t.score)
        finite = [t for t in finite if forgets(t)]
        finite = finite or [with_less_feedback(data, best, seed + 1, work)]
    best = min(finite, key=lambda t: t.score)
    starts = list(finite) if join else list(trained)
    if join and len(finite) > 1:
        spec, weights = mean_of([(t.spec, t.weights) for t in finite])
        score = float(np.mean([t.score for t in finite]))  # each on blocks that it did not see
        mean = Trained(spec, weights, score, members=len(finite), decay=best.decay)
        if not data.memory or forgets(mean):
            best = mean
    if all(t is not best for t in starts):
        starts.append(best)
    return NetworkChoice(tuple(starts), best, settling(data, best.spec, best.weights, seed))


def mean_of(members: Sequence[Member]) -> Member:
    """Return shape and weights of the mean of networks with the same inputs and limits.

    members : those with hidden layers have the same number of them
    They stand side by side in wider layers that are block-diagonal, so the mean is a NARX like any
    other, and it feeds back the mean. Errors of members that differ partly cancel.
    Raises ValueError if there is no member, or their numbers of layers differ.
    """
    depths = {len(spec.hidden) for spec, _ in members if spec.hidden}
    if not members or len(depths) > 1:
        raise ValueError(f"{len(members)} members with {sorted(depths)} layers: no mean")
    common = _common([spec for spec, _ in members])
    path, parts = np.zeros(common.n_regressors), list[FloatArray]()
    stacks = [layers(*member) for member in members]
    for (spec, weights), stack in zip(members, stacks, strict=True):
        stack[0] = (widened(stack[0][0], spec, common), stack[0][1])
        if not spec.hidden:
            path += stack[0][0][0]
        elif spec.linear_path:
            path += widened(linear_path(spec, weights)[None], spec, common)[0]
    deep = [stack for stack in stacks if len(stack) > 1]
    for depth in range(len(common.hidden)):
        matrices = [stack[depth][0] for stack in deep]
        joined = block_diag(*matrices) if depth else np.concatenate(matrices)
        parts += [joined.ravel(), *(stack[depth][1] for stack in deep)]
    last = np.mean([stack[-1][1] for stack in stacks], axis=0)
    if not deep:
        return common, np.concatenate([path / len(members), last])
    parts += [np.concatenate([stack[-1][0][0] for stack in deep]) / len(members), last]
    return common, np.concatenate([*parts, path / len(members)] if common.linear_path else parts)


def _common(specs: Sequence[Spec]) -> Spec:
    """Return the shape that holds all of these side by side."""
    deep = [spec.hidden for spec in specs if spec.hidden]
    edges = sorted({edge for spec in specs for box in spec.boxes for edge in box})
    boxes = specs[0].input_boxes if len(set(specs)) == 1 else tuple(pairwise(edges))
    return replace(
        specs[0],
        lags=max(spec.lags for spec in specs),
        hidden=tuple(sum(widths) for widths in zip(*deep, strict=True)),
        input_boxes=boxes,
        linear_path=bool(deep) and any(s.linear_path or not s.hidden for s in specs),
    )
