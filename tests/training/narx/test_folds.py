"""Trainings that leave out different blocks: the choice among them, their mean as one network."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from tests.helpers.drives.recordings import recording_of
from training.narx.network import Spec, forward, initial_weights, regressors
from training.narx.search.mean import choose, mean_of
from training.narx.search.stages import Trained, blocks_of
from training.narx.search.structure import Search, Structure, boxes, folds_of
from training.narx.work import PER_MINUTE, Work
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, prepare


def drive(pole: float, n: int = 4000, seed: int = 1) -> Recording:
    """Two inputs held for random times, a first-order lag, 0.5 s dead time of the second."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, (n // 20, 2)).repeat(20, axis=0)
    late = np.concatenate([np.zeros(5), u[:-5, 1]])
    y = lfilter([1 - pole], [1, -pole], u[:, 0] - 0.5 * late) + 0.01 * rng.standard_normal(n)
    return recording_of({"u0": u[:, 0], "u1": u[:, 1], "y": y})


def prepared(pole: float, n: int = 4000) -> Prepared:
    return prepare([drive(pole, n)], ["u0", "u1"], "y")


def folds(n: int = 1200) -> list[Prepared]:
    others = (prepare([drive(0.9, n)], ["u0", "u1"], "y", seed=seed) for seed in (1, 2, 3))
    return folds_of(prepared(0.9, n), others)


@pytest.mark.parametrize("most_tried", [1, 4])
def test_the_mean_has_seen_all_folds_and_errs_no_more_than_most_members(most_tried: int) -> None:
    data = folds()
    search = Search(data, most_tried, 0, Work(0.02 * PER_MINUTE), 1)
    search.run()
    members = search.members(False, Work())
    assert {each.fold for each in members} == set(range(len(data)))
    mean = choose(data[0], members, 0, Work(), join=True).model
    assert mean.members == len(members)
    own = prepare([drive(0.9, 1200, seed=2)], ["u0", "u1"], "y")
    unseen = [blocks_of(own, t.spec, Role.TEST).score(t.weights) for t in (mean, *members)]
    assert unseen[0] < 1.001 * np.median(unseen[1:])  # of a linear plant all are nearly one model


def test_the_test_blocks_stay_unseen_in_every_fold() -> None:
    data = folds()
    assert len(data) > 2
    test = data[0].role == Role.TEST
    assert all(np.array_equal(each.role == Role.TEST, test) for each in data)
    held_out = np.array([each.role == Role.VALIDATE for each in data])
    assert (held_out.any(axis=1)).all()
    assert len(np.unique(held_out, axis=0)) > 1


def test_a_block_whose_output_is_lost_before_the_memory_is_full_is_not_scored() -> None:
    data = prepared(0.9, 1200)
    role, weight = data.role.copy(), data.samples.weight.copy()
    role[:200], weight[4:200] = Role.VALIDATE, 0.0
    lost = replace(data, role=role, samples=replace(data.samples, weight=weight))
    spec = Structure().spec(data)  # a memory of 5 samples
    assert np.isfinite(blocks_of(lost, spec).score(np.zeros(spec.n_weights)))


def test_blocks_of_which_the_test_leaves_next_to_nothing_make_no_fold() -> None:
    # GIVEN other blocks that lie within those of the test but for five samples
    data = prepared(0.9, 1200)
    role = np.where(data.role == Role.TEST, Role.VALIDATE, Role.TRAIN).astype(data.role.dtype)
    role[:5] = Role.VALIDATE
    # WHEN folds are made THEN there is none of them, as no memory could be scored on it
    assert len(folds_of(data, [replace(data, role=role)])) == 1


def predicted(spec: Spec, weights: FloatArray, u: FloatArray, y: FloatArray) -> FloatArray:
    """Return the one-step predictions of the last samples."""
    return forward(spec, weights, regressors(spec, u, y))[-30:]


@pytest.mark.parametrize("linear_path", [True, False])
def test_the_mean_of_different_memories_and_widths_is_one_network(linear_path: bool) -> None:
    # GIVEN trainings of several memories and widths, and linear ones
    rng = np.random.default_rng(5)
    u, y = rng.normal(size=(120, 2)), rng.normal(size=120)

    def shape(longest: int, lags: int, hidden: tuple[int, ...]) -> Spec:
        path = linear_path and bool(hidden)
        return Spec(2, lags, hidden, 0, -3.0, 3.0, boxes(longest), linear_path=path)

    alike = [shape(20, 2, (4, 3)), shape(12, 3, (5, 2))]
    for specs in ([shape(60, 1, (4,)), shape(9, 3, (2,)), shape(2, 5, ())], alike, alike[:1]):
        members = [(spec, initial_weights(spec, rng) + 0.1) for spec in specs]
        # WHEN they are joined THEN one network predicts their mean
        spec, weights = mean_of(members)
        mean = np.mean([predicted(*member, u, y) for member in members], axis=0)
        np.testing.assert_allclose(predicted(spec, weights, u, y), mean, atol=1e-12)
    with pytest.raises(ValueError, match="no mean"):
        mean_of([(each, initial_weights(each, rng)) for each in (alike[0], shape(5, 1, (3,)))])


def constant(spec: Spec, feedback: float, score: float) -> Trained:
    """Return a linear training that predicts its own past, ``feedback`` times."""
    weights = np.zeros(spec.n_weights)
    weights[-2] = feedback
    return Trained(spec, weights, score)


def test_lambda_is_forgotten_whatever_the_score_and_other_outputs_need_not_be() -> None:
    # GIVEN a training that remembers, and one that forgets and follows its blocks worse
    data = prepared(0.8)
    spec = Structure(2, 1, ()).spec(data)
    remembers, forgets = constant(spec, 1.0, 0.1), constant(spec, 0.5, 0.9)
    # WHEN the output is lambda THEN the one that forgets is the model
    lambda_ = replace(data, memory=50)
    assert choose(lambda_, [remembers, forgets], 0, Work(), join=True).model is forgets
    assert choose(lambda_, [remembers, forgets], 0, Work(), join=False).model is forgets
    # AND of another output the score alone decides, and the mean has both
    assert choose(data, [remembers, forgets], 0, Work(), join=False).model is remembers
    mean = choose(data, [remembers, forgets], 0, Work(), join=True).model
    assert mean.members == 2
    assert mean.weights[-2] == pytest.approx(0.75)


def test_if_every_training_remembers_lambda_the_best_one_gets_less_feedback() -> None:
    data = replace(prepared(0.8), memory=50)
    spec = Structure(2, 1, ()).spec(data)
    found = choose(data, [constant(spec, 1.0, 0.9), constant(spec, 1.1, 0.8)], 0, Work(), join=True)
    assert found.gap.gap <= found.gap.limit
    assert found.model.stages[-1].name == "less feedback"
    assert found.model.score < 0.5  # standard deviations of the output
