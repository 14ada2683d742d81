"""Forgetting: two histories must end at one prediction, also where a drive stays for long."""

from dataclasses import replace

import numpy as np

from tests.training.narx.test_folds import prepared
from training.narx.network import Spec, simulate
from training.narx.search.stability import contraction, settling
from training.narx.search.structure import Structure

SPEC = Spec(2, 1, (1,), 0, -3.0, 3.0)


def feedback(gain: float) -> np.ndarray:
    """Weights of y(t) = tanh(gain y(t-1) + 5 u0(t)): above 1, two steady states about u0 = 0."""
    return np.array([5.0, 0.0, 0.0, 0.0, gain, 0.0, 1.0, 0.0])


def test_two_steady_states_are_seen_although_every_recorded_drive_moves_on() -> None:
    # GIVEN inputs that change every 20 samples, and a memory of ten such changes
    data = replace(prepared(0.8), memory=200)
    # WHEN a network has two steady states where the first input is small
    weights = feedback(2.0)
    # THEN the recorded inputs make it forget all the same
    start = np.arange(10, 3700, 210)
    runs = [
        simulate(SPEC, weights, data.samples.u, start, start + 201, np.full((len(start), 1), first))
        for first in (-3.0, 3.0)
    ]
    np.testing.assert_allclose(*(run[start + 200] for run in runs), atol=1e-9)
    # AND the check, which holds operating points, finds both states
    found = contraction(data, SPEC, weights, seed=0)
    assert found.gap > 30.0 * found.limit


def test_one_steady_state_at_every_operating_point_is_forgetting() -> None:
    data = replace(prepared(0.8), memory=200)
    found = contraction(data, SPEC, feedback(0.5), seed=0)
    assert found.gap < 0.01 * found.limit


def test_the_longest_block_may_be_the_last() -> None:
    assert replace(prepared(0.95), role=np.array([0, 1, 0, 0, 0])).longest_block == 3


def test_a_slow_model_settles_after_as_long_as_it_takes_to_forget() -> None:
    # GIVEN linear models that forget a step by a tenth, a hundredth and nothing per sample
    data = prepared(0.95)
    spec = Structure(2, 1, ()).spec(data)
    for pole, samples in ((0.9, 50), (0.97, 200), (1.0, 50)):
        weights = np.zeros(spec.n_weights)
        weights[-2] = pole
        # WHEN their histories are compared THEN the time is long enough, or 50 if none is
        found = settling(data, spec, weights, 0)
        assert found.samples == samples
        assert (found.gap <= found.limit) == (pole < 1.0)
