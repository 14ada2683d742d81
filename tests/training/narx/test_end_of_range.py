"""What a network learns beside its samples: the end of a range, a lasting change of fuel."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from monitor.model.step import Model
from tests.helpers.drives.recordings import recording_of
from training.narx.algorithms.objectives import ClosedLoop
from training.narx.fit import FitOptions, FitSource, fit
from training.narx.network import Spec
from training.narx.search.stages import pieces
from training.recordings.recording import Recording
from training.recordings.samples.augmentation import FUEL_TURN, fuel_turns
from training.recordings.samples.preparation import Prepared, Role, prepare

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


PERIOD_NS = 100_000_000
NAMES = ("air_mass_mg", "fuel_mass_mg", "lambda_measured")
N = 4000


def closed_loop(seed: int, noise: float = 0.02) -> Recording:
    """Lambda is held at 1 with a dither of 2 %; the broadcast fuel is inexact."""
    rng = np.random.default_rng(seed)
    air = 300.0 + 150.0 * np.sin(np.arange(N) / 83.0) + 60.0 * np.sin(np.arange(N) / 19.0)
    dither = 0.02 * np.sign(np.sin(2.0 * np.pi * np.arange(N) / 17.0))
    fuel = air / 14.7 * (1.0 + dither)
    phi = np.ones(N)
    for k in range(3, N):
        phi[k] = phi[k - 1] + 0.4 * (14.7 * fuel[k - 3] / air[k - 3] - phi[k - 1])
    broadcast = fuel * (1.0 + noise * rng.standard_normal(N))
    columns = (air, broadcast, 1.0 / phi + 0.001 * rng.standard_normal(N))
    return recording_of(dict(zip(NAMES, columns, strict=True)), f"loop{seed}.csv")


def predicted_phi(path: Path, recording: Recording, factor: float) -> FloatArray:
    u = recording.values[:, :2] * np.array([1.0, factor])
    model = Model.load(path)
    model.reset(u[:1], np.array([1.0]))
    return np.asarray(1.0 / model.run_batch(u[np.newaxis].astype(np.float32))[0])


def test_a_network_learned_in_closed_loop_follows_a_lasting_change_of_fuel(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    options = FitOptions(lags=4, hidden=(4,), starts=1, budget_minutes=0.05, threads=1)
    fit(FitSource([closed_loop(1)], NAMES[:2], NAMES[2]), path, options)
    other = closed_loop(2, noise=0.0)
    richer = predicted_phi(path, other, 1.05)[100:].mean()
    leaner = predicted_phi(path, other, 0.95)[100:].mean()
    assert 0.09 < richer - leaner < 0.11


def test_fuel_and_phi_are_turned_together_where_the_network_learns_and_nowhere_else() -> None:
    recording = closed_loop(3)
    data = prepare([recording], NAMES[:2], NAMES[2], turn_fuel=True)
    fuel = data.samples.u[:, 1] * data.scaling.u_std[1] + data.scaling.u_mean[1]
    phi = data.scaling.unscale_y(data.samples.y)
    by_fuel = fuel / recording.values[:, 1]
    by_phi = phi * recording.values[:, 2]
    train = data.role == Role.TRAIN
    assert np.abs(by_fuel - by_phi).max() < 1e-9
    assert np.abs(by_fuel[~train] - 1.0).max() < 1e-9
    assert by_fuel[train].std() > FUEL_TURN / 5.0
    assert (data.output.minimum, data.output.maximum) == (
        recording.values[train, 2].min(),
        recording.values[train, 2].max(),
    )


def test_the_fuel_is_turned_slowly_and_stands_as_recorded_at_the_ends_of_each_block() -> None:
    rows = np.repeat([True, False, True], [900, 200, 500])
    turns = fuel_turns(rows, PERIOD_NS, seed=4)
    assert np.abs(turns - 1.0).max() <= FUEL_TURN
    assert np.abs(np.diff(turns)).max() < 0.003
    assert (turns[~rows] == 1.0).all()
