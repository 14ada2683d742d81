"""A model for recordings that are judged several times."""

import numpy as np
import pytest

from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from training.limits.repeated_model import RepeatedModel


def test_a_run_over_the_same_inputs_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # GIVEN a model's predictions for two recordings
    plain = Model.load(shipped_model(), 2)
    low, high = np.array([(i.minimum, i.maximum) for i in plain.card.inputs]).T
    u = np.random.default_rng(1).uniform(low, high, (2, 50, plain.n_inputs))
    wanted = plain.run_batch(u)
    repeated = RepeatedModel.of(Model.load(shipped_model()))
    # WHEN the recordings run through the model that remembers
    first, again = repeated.with_batch(2), repeated.with_batch(2)
    np.testing.assert_array_equal(first.run_batch(u), wanted)
    # THEN a second run from the same state is not computed, and leaves the same state
    with monkeypatch.context() as patched:
        patched.delattr(Model, "_advance")
        np.testing.assert_array_equal(again.run_batch(u), wanted)
    np.testing.assert_array_equal(again.state, plain.state)
    # AND one from another state is
    np.testing.assert_array_equal(again.run_batch(u), plain.run_batch(u))
