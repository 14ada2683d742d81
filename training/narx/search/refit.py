"""Short records: the trainings go on with the blocks that chose them, and their mean is the model.

Two blocks of a hundred samples say little about which training is best, and the samples in them are
missed in training. So every training that was begun goes on for a fixed number of epochs on all
blocks but those of the test. The model is the mean of the two that then follow these blocks best,
in free run over the whole recordings, and of the two that did before: nothing stops the further
epochs, and the mean with those that were stopped is the safer one. The blocks of the test, which
set the limits, stay unseen.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.narx.algorithms.lm import LmOptions, minimise
from training.narx.algorithms.objectives import ClosedLoop
from training.narx.network import Spec
from training.narx.search.stability import contraction
from training.narx.search.stages import RANDOM_SHARE, Trained, free_run, pieces, random_pieces
from training.narx.search.starts import committee
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role

HORIZON: Final = 1000  # samples of the free run that is trained
EPOCHS: Final = 25  # nothing is left to stop it
OF_EACH: Final = 2  # members that were trained further, and as many that were not
LIMIT_SAMPLES: Final = 500  # ten windows, with which limits can be set


def may_refit(data: Prepared) -> bool:
    """Return whether the validation blocks are free to be trained on.

    They are not where the limits need them: where the blocks of the test alone are too short to
    set limits, and both together are long enough.
    """
    counts = [int((data.enabled & (data.role == role)).sum()) for role in Role]
    test = counts[Role.TEST]
    return test >= LIMIT_SAMPLES or test + counts[Role.VALIDATE] < LIMIT_SAMPLES


def all_but_test(data: Prepared) -> Prepared:
    """Return the data with the validation blocks among those that train."""
    role = np.where(data.role == Role.VALIDATE, Role.TRAIN, data.role).astype(data.role.dtype)
    return replace(data, role=role)


def refitted(
    data: Prepared, trained: Sequence[Trained], best: int, seed: int, work: Work
) -> Trained | None:
    """Return the mean of the best trainings of one shape, trained further on ``data``.

    data : without validation blocks, see ``all_but_test``
    best : number of the training that was chosen
    None if a linear model was chosen, which needs no more samples, or if the mean does not forget
    its history, though the data have a memory.
    """
    if not trained[best].spec.hidden:
        return None
    begun = [t for t in trained if t.members == 1 and t.spec.hidden]
    memory = max(t.spec.memory for t in begun)
    again = [replace(t, weights=_further(data, t, seed, work)) for t in begun]

    def in_order(members: Sequence[Trained]) -> list[Trained]:
        return sorted(members, key=lambda t: whole_error(data, t.spec, t.weights, memory))

    again = in_order(again)
    spec = again[0].spec
    both = [[t for t in each if t.spec == spec][:OF_EACH] for each in (again, in_order(begun))]
    members = [t.weights for each in both for t in each]
    wide, weights = committee(spec, members)
    gap = contraction(data, wide, weights, seed)
    if data.memory and not gap.gap <= gap.limit:
        return None
    score = whole_error(data, wide, weights, memory)
    return Trained(wide, weights, score, members=len(members))


def _further(data: Prepared, begun: Trained, seed: int, work: Work) -> FloatArray:
    """Return the training's weights after further epochs on all of the data."""
    random = random_pieces(
        data, begun.spec, np.random.default_rng(seed), RANDOM_SHARE * len(data.role)
    )
    taken = pieces(data, begun.spec, HORIZON) + random
    objective = ClosedLoop(begun.spec, data.samples, taken, decay=begun.decay)
    options = LmOptions(epochs=EPOCHS)
    meter = work.on(objective.n_samples, begun.spec.n_weights)
    return minimise(objective, begun.weights, options, meter=meter).weights


def whole_error(data: Prepared, spec: Spec, weights: FloatArray, memory: int) -> float:
    """Return the weighted RMSE of the free run over whole recordings, without the test blocks.

    memory : first samples of the data that are not scored
    """
    run = free_run(data, spec, weights)
    rows = (data.role != Role.TEST) & np.isfinite(run)
    rows[:memory] = False
    weight, error = data.samples.weight[rows], (run - data.samples.y)[rows]
    return float(np.sqrt(weight @ error**2 / weight.sum()))
