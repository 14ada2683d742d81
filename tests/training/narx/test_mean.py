"""The choice among trainings, and their mean as one network."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.types import FloatArray
from tests.training.narx.test_folds import prepared
from training.narx.network import Spec, forward, initial_weights, regressors
from training.narx.search.mean import choose, mean_of
from training.narx.search.stages import Trained
from training.narx.search.structure import Structure, boxes
from training.narx.work import Work


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
