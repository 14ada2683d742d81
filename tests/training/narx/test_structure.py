"""The choice of memory and size by the data, and what it needs: boxed lags and a linear path."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from tests.helpers.drives.recordings import recording_of
from training.narx.algorithms.objectives import ClosedLoop, Pieces, Samples, one_step
from training.narx.fit import FitOptions, FitResult, FitSource, fit
from training.narx.network import Spec, describe, forward, initial_weights, regressors
from training.narx.search.stages import blocks_of, free_run
from training.narx.search.structure import boxes
from training.recordings.recording import Recording, load
from training.recordings.samples.preparation import prepare

BOXED = Spec(
    n_inputs=2,
    lags=2,
    hidden=(4,),
    input_lag_start=0,
    y_min=-3.0,
    y_max=3.0,
    input_boxes=((0, 1), (1, 3), (3, 7)),
    linear_path=True,
)


def recording(u: FloatArray, y: FloatArray, name: str = "drive.csv") -> Recording:
    inputs = {f"u{i}": column for i, column in enumerate(u.reshape(len(y), -1).T)}
    return recording_of(inputs | {"y": y}, name)


def analyser(seed: int, n: int = 5000) -> Recording:  # fewer choose by several sets of blocks
    """A valve's flow, to which an analyser answers 2.2 s later through its cell and a hose."""
    rng = np.random.default_rng(seed)
    hold = np.searchsorted(np.cumsum(rng.integers(10, 60, n)), np.arange(n), side="right")
    valve = rng.uniform(0.0, 1.0, n)[hold]
    flow = np.sqrt(valve) * (1.0 - 0.4 * valve)
    late = np.concatenate([np.full(22, flow[0]), flow[:-22]])
    cell = lfilter([0.25], [1.0, -0.75], late, zi=[0.75 * late[0]])[0]
    return recording(valve[:, None], cell + 0.003 * rng.standard_normal(n), f"analyser{seed}.csv")


def test_boxes_hold_every_lag_once_and_widen() -> None:
    for longest in range(1, 100):
        covered = [lag for first, stop in boxes(longest) for lag in range(first, stop)]
        assert covered == list(range(longest + 1))
    widths = [stop - first for first, stop in boxes(60)]
    assert widths[:5] == [1] * 5
    assert max(widths) >= 9


@given(st.integers(1, 3), st.booleans(), st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_regressors_are_means_over_boxes(n_inputs: int, lag_zero: bool, widths: list[int]) -> None:
    edges = np.cumsum([0 if lag_zero else 1, *widths]).tolist()
    spec = Spec(n_inputs, 2, (3,), input_boxes=tuple(pairwise(edges)))
    rng = np.random.default_rng(7)
    u, y = rng.normal(size=(40, n_inputs)), rng.normal(size=40)
    rows = regressors(spec, u, y)
    assert rows.shape == (40 - spec.memory, spec.n_regressors)
    t = 30
    means = [u[[t - lag for lag in range(a, b)]].mean(axis=0) for a, b in spec.boxes]
    expected = np.concatenate([*means, [y[t - 1], y[t - 2]]])
    np.testing.assert_allclose(rows[t - spec.memory], expected, atol=1e-12)


def test_derivatives_hold_for_boxes_and_the_linear_path() -> None:
    rng = np.random.default_rng(3)
    u, y = rng.normal(size=(60, 2)), rng.normal(size=60)
    weights = 0.5 * initial_weights(BOXED, rng)
    weights[-BOXED.n_regressors :] = 0.1 * rng.normal(size=BOXED.n_regressors)
    start, stop = np.array([6, 30]), np.array([30, 60])
    history = y[start[:, None] - [1, 2]]
    part = Pieces(start, stop, np.zeros_like(start), history)
    loop = ClosedLoop(BOXED, Samples(u, y, np.ones(60)), part, np.float64, decay=0.01)
    _, _, gradient = loop.normal(weights)
    rows = regressors(BOXED, u, y)
    ahead_by_one = one_step(BOXED, Samples(u, y, np.ones(60)), np.arange(6, 60), np.float64)
    slopes, _ = next(ahead_by_one.blocks(weights))
    for i in range(BOXED.n_weights):
        step = np.zeros_like(weights)
        step[i] = 1e-6
        slope = (loop.cost(weights + step) - loop.cost(weights - step)) / 2e-6
        assert 2 * gradient[i] == pytest.approx(slope, rel=1e-5, abs=1e-8)
        ahead, behind = (forward(BOXED, w, rows) for w in (weights + step, weights - step))
        np.testing.assert_allclose(slopes[:, i], (ahead - behind) / 2e-6, atol=1e-7)


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    out = tmp_path_factory.mktemp("late") / "model.onnx"
    return fit(FitSource([analyser(1)], ["u0"], "y"), out, FitOptions(starts=1, budget_minutes=0.4))


def test_a_late_analyser_is_given_a_long_memory(late: FitResult) -> None:
    assert late.chosen.model.spec.memory >= 20
    assert late.card.fit["test"]["fit_percent"] > 80
    assert "boxes" in describe(late.chosen.model.spec)
    tried = {t.structure.longest: t for t in late.tries}
    assert tried[34].rmse < 0.5 * tried[5].rmse


def test_the_file_of_a_boxed_model_predicts_what_the_training_did(late: FitResult) -> None:
    card = Model.load(late.path).card
    assert card.structure["linear_path"]
    assert card.lags == late.chosen.model.spec.memory
    assert card.input_lag_start == 0
    drive, first = analyser(1), late.chosen.model.spec.memory
    model, output = Model.load(late.path), drive.column("y")
    run = np.empty(len(output))
    for t, u in enumerate(drive.column("u0")[:, None]):
        run[t] = model.step(u)
        if t < first:
            model.force_output(output[t])
    trained = late.data.scaling.unscale_y(
        free_run(late.data, late.chosen.model.spec, late.chosen.model.weights)
    )
    np.testing.assert_allclose(run[first:], trained[first:], atol=1e-4)


def test_a_short_record_of_a_nearly_linear_plant_gets_a_small_model(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-1, 1, 60), 10)
    y = lfilter([0.2], [1.0, -0.8], u) + 0.2 * rng.standard_normal(600)
    source = FitSource([recording(u[:, None], y)], ["u0"], "y")
    result = fit(source, tmp_path / "m.onnx", FitOptions(starts=1, budget_minutes=0.1))
    largest = max(t.n_weights for t in result.tries)
    assert max(t.spec.n_weights for t in result.chosen.members) < 0.6 * largest
    truth = lfilter([0.2], [1.0, -0.8], u)
    off = result.predicted[60:] - truth[60:]
    assert np.sqrt(np.mean(off**2)) < 0.06  # the noise is 0.2, the signal 0.25


def test_a_memory_longer_than_the_blocks_is_refused() -> None:
    data = prepare([analyser(1, 300)], ["u0"], "y")
    spec = Spec(1, 2, (3,), 0, input_boxes=boxes(400))
    with pytest.raises(RecordingError, match="longer than 400 lags"):
        blocks_of(data, spec)


def test_tables_of_any_sample_period_are_used_sample_for_sample(tmp_path: Path) -> None:
    for period_s in (1.0 / 51_200, 4.0):  # an electronic circuit, two water tanks
        rows = np.column_stack([np.arange(400) * period_s, np.arange(400) % 7])
        np.savetxt(tmp_path / "t.csv", rows, "%.17g", ",", header="time_s,y", comments="")
        drive = load(tmp_path / "t.csv")
        assert len(drive.values) == 400
        assert drive.period_ns == pytest.approx(period_s * 1e9, rel=1e-4)
