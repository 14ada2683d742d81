"""A sensor that stands at an end of its range: the model's output ends there, too."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.helpers.drives.recordings import recording_of
from training.narx.algorithms.objectives import ClosedLoop
from training.narx.network import Spec
from training.narx.search.stages import pieces
from training.recordings.samples.preparation import Prepared, prepare

END = 0.4


def drive(clipped: bool, n: int = 4000) -> Prepared:
    """A first-order lag of steps, read by a sensor whose range may end at ``END``."""
    u = np.random.default_rng(1).uniform(-1, 1, n // 20).repeat(20)
    y = lfilter([0.2], [1, -0.8], u)
    recording = recording_of({"u": u, "y": np.minimum(y, END) if clipped else y})
    return prepare([recording], ["u"], "y")


def test_the_output_has_no_margin_where_the_sensor_stands() -> None:
    scaling, free = drive(clipped=True).scaling, drive(clipped=False).scaling
    assert scaling.y_high == END
    assert scaling.y_low < -1.0
    # a reading that only peaks has its margin
    assert free.y_high > 1.0


def test_a_prediction_beyond_the_end_is_no_error_and_one_below_it_is() -> None:
    # GIVEN one neuron without inputs, whose prediction is its bias
    data = drive(clipped=True)
    spec = Spec(1, 1, (), 0, *data.scaling.y_scaled_limits)
    objective = ClosedLoop(spec, data.samples, pieces(data, spec, 100), dtype=np.float64)
    stands = data.samples.y == spec.y_max
    cut = objective.pieces
    scored = np.concatenate([np.arange(*ends) for ends in zip(cut.start, cut.stop, strict=True)])
    for beyond in (0.5, -0.5):
        weights = np.zeros(spec.n_weights)
        weights[-1] = spec.y_max + beyond
        error = weights[-1] - data.samples.y[scored]
        if beyond > 0:
            error[stands[scored]] = 0.0
        # THEN cost and gradient are those of the readings that the prediction misses
        assert objective.cost(weights) == pytest.approx(np.mean(error**2))
        cost, _, gradient = objective.normal(weights)
        assert cost == pytest.approx(np.mean(error**2))
        step = 1e-6 * np.eye(spec.n_weights)[-1]
        slope = (objective.cost(weights + step) - objective.cost(weights - step)) / 2e-6
        assert 2.0 * gradient[-1] == pytest.approx(slope, rel=1e-4)
