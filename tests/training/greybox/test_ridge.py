"""Ridge regression with held-out penalty, and the variation of healthy drives."""

import numpy as np
import pytest

from training.greybox.fit import ridge
from training.greybox.fit.case import shrink


def test_a_ridge_predicts_what_is_there_and_nothing_of_noise() -> None:
    rng = np.random.default_rng(1)
    x = rng.standard_normal((4000, 8))
    y = 0.5 * x[:, 2] + 0.1 * rng.standard_normal(4000)
    fold = np.arange(4000) // 100 % 5
    found = ridge.fit(x, y, fold)
    assert found.predict(x) == pytest.approx(0.5 * x[:, 2], abs=0.05)
    pure = rng.standard_normal(4000)
    assert np.mean((pure - ridge.fit(x, pure, fold).held_out) ** 2) > 0.99 * np.mean(pure**2)


def test_a_ridge_says_of_what_hardly_moved_what_is_known_of_it() -> None:
    # GIVEN two columns whose weights are known to be much alike, one of which hardly moves
    rng = np.random.default_rng(2)
    x = rng.standard_normal((4000, 2)) * [1.0, 0.02]
    y = x @ [2.0, 9.0] + rng.standard_normal(4000)
    fold = np.arange(4000) // 100 % 5
    alike = np.array([[1.0, -1.0], [-1.0, 1.0]]) / 0.1**2
    # THEN that one's weight is the other's, and not what its small moves say
    assert ridge.fit(x, y, fold).weights[1] > 5.0
    assert ridge.fit(x, y, fold, prior=alike).weights == pytest.approx([2.0, 2.0], abs=0.3)
    # nor is one that did not move at all without a weight
    still = x * [1.0, 0.0]
    assert ridge.fit(still, y, fold).weights[1] == 0.0
    assert ridge.fit(still, y, fold, prior=alike).weights == pytest.approx([2.0, 2.0], abs=0.1)


def test_random_coefficients_take_out_their_own_direction_and_leave_the_rest() -> None:
    rng = np.random.default_rng(2)
    column = rng.standard_normal((1000, 1))
    root = shrink(10.0 * column)
    assert np.abs(root.apply(3.0 * column[:, 0])).max() < 0.05
    other = rng.standard_normal(1000)
    other -= column[:, 0] * (other @ column[:, 0]) / (column[:, 0] @ column[:, 0])
    np.testing.assert_allclose(root.apply(other), other, atol=1e-6)
    np.testing.assert_allclose(root.apply(other[:, None])[:, 0], other, atol=1e-6)
    # the covariance that the root stands for
    whole = np.linalg.inv(np.eye(1000) + 100.0 * column @ column.T)
    np.testing.assert_allclose(
        root.apply(root.apply(column[:, 0])), whole @ column[:, 0], atol=1e-6
    )
