"""A short record: the starts leave out different blocks, and their mean has seen all of them."""

from dataclasses import replace

import numpy as np

from tests.training.narx.test_linear_start import drive, prepared
from training.narx.network import Spec
from training.narx.search.folds import folds_of, free_folds, trained_on_all
from training.narx.search.stages import free_run_score
from training.narx.search.starts import Starts, means
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared, Role, prepare

SPEC = Spec(2, 2, (3,), 0, -3.0, 3.0, ((0, 1), (1, 3), (3, 6), (6, 9)), linear_path=True)


def folds(n: int = 1200) -> list[Prepared]:
    others = (prepare([drive(0.9, n)], ["u0", "u1"], "y", seed=seed) for seed in (1, 2, 3))
    return folds_of(prepared(0.9, n), others)


def test_the_starts_take_turns_over_the_folds_and_their_mean_is_better_on_unseen_blocks() -> None:
    data = folds()
    runs = Starts(data, 0, Work(), 1)
    trained = runs.train([(start, (SPEC, 1e-4)) for start in range(2 * len(data))])
    assert [each.fold for each in trained] == 2 * list(range(len(data)))
    (mean,) = means(data, trained, 0)
    assert mean.members == len(data)
    assert mean.spec.hidden == (3 * len(data),)
    unseen = [free_run_score(data[0], t.spec, t.weights, Role.TEST) for t in (mean, *trained)]
    assert unseen[0] < np.median(unseen[1:])


def test_the_test_blocks_stay_unseen_in_every_fold() -> None:
    data = folds()
    assert len(data) > 2
    test = data[0].role == Role.TEST
    assert all(np.array_equal(each.role == Role.TEST, test) for each in data)
    held_out = np.array([each.role == Role.VALIDATE for each in data])
    assert (held_out.any(axis=1)).all()
    assert len(np.unique(held_out, axis=0)) > 1
    assert set(trained_on_all(data[0]).role[~test]) == {Role.TRAIN}


def test_blocks_that_the_limits_need_are_not_trained_on() -> None:
    assert len(free_folds(folds(1200))) > 1  # both together are too short for limits
    assert len(free_folds(folds(2800))) == 1  # both together are enough, the test alone is not
    assert len(free_folds(folds(4600))) > 1  # the test alone is enough


def test_blocks_of_which_the_test_leaves_next_to_nothing_make_no_fold() -> None:
    # GIVEN other blocks that lie within those of the test but for five samples
    data = prepared(0.9, 1200)
    role = np.where(data.role == Role.TEST, Role.VALIDATE, Role.TRAIN).astype(data.role.dtype)
    role[:5] = Role.VALIDATE
    # WHEN folds are made THEN there is none of them, as no memory could be scored on it
    assert len(folds_of(data, [replace(data, role=role)])) == 1
