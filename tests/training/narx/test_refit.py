"""A short record: the model is trained on all blocks but those of the test, and is a mean."""

from dataclasses import replace

import numpy as np

from tests.training.narx.test_linear_start import prepared
from training.narx.network import Spec
from training.narx.search.refit import all_but_test, may_refit, refitted, whole_error
from training.narx.search.stages import Trained, free_run_score, train
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role

SPEC = Spec(2, 2, (3,), 0, -3.0, 3.0, ((0, 1), (1, 3), (3, 6), (6, 9)), linear_path=True)


def begun(data: Prepared, seed: int) -> Trained:
    """A training that was stopped early."""
    return train(data, SPEC, seed, horizons=(20,), epochs={1: 2, 20: 1}, decay=1e-4)


def test_the_mean_of_the_trainings_goes_on_over_the_blocks_that_chose_them() -> None:
    data = prepared(0.9, 1200)
    starts = [begun(data, seed) for seed in range(4)]
    best = int(np.argmin([t.score for t in starts]))
    everything = all_but_test(data)
    again = refitted(everything, starts, best, 0, Work())
    assert again
    assert again.members == 4
    assert again.spec.hidden == (12,)
    before = whole_error(everything, SPEC, starts[best].weights, SPEC.memory)
    assert again.score < 0.95 * before
    unseen = [free_run_score(data, t.spec, t.weights, Role.TEST) for t in (again, starts[best])]
    assert unseen[0] < unseen[1]


def test_the_test_blocks_stay_unseen() -> None:
    data = all_but_test(prepared(0.9, 1200))
    test = data.role == Role.TEST
    inside = test & np.roll(test, -1) & np.roll(test, -2)  # the last two begin the next block's run
    assert inside.sum() > 150
    wrong = data.samples.y + 5.0 * inside
    other = replace(data, samples=replace(data.samples, y=wrong))
    starts = [begun(prepared(0.9, 1200), 0)]
    right, same = (refitted(d, starts, 0, 0, Work()) for d in (data, other))
    assert right
    assert same
    np.testing.assert_array_equal(right.weights, same.weights)


def test_blocks_that_the_limits_need_are_not_trained_on() -> None:
    assert may_refit(prepared(0.9, 1200))  # both together are too short for limits
    assert not may_refit(prepared(0.9, 2800))  # both together are enough, the test alone is not
    assert may_refit(prepared(0.9, 4600))  # the test alone is enough
