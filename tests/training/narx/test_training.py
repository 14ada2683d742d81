"""The NARX: gradients, Levenberg–Marquardt in open and closed loop, preparation."""

import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from monitor.base.errors import RecordingError, UsageError
from monitor.base.types import FloatArray
from tests.helpers.drives.recordings import recording_of
from tests.training.narx.test_structure import prepared
from training.cli.progress import LINE_S, Budget, Progress
from training.narx.algorithms.lm import minimise
from training.narx.algorithms.objectives import ClosedLoop, Pieces, Samples, one_step
from training.narx.network import Spec, forward, initial_weights, simulate
from training.narx.search.stability import contraction, settling
from training.narx.search.stages import HORIZONS, Trained, blocks_of, train
from training.narx.search.structure import Structure
from training.narx.work import PER_MINUTE
from training.recordings.recording import Recording
from training.recordings.samples.outliers import outlier_mask
from training.recordings.samples.preparation import Role, prepare

RNG = np.random.default_rng


def recording(
    u: FloatArray, y: FloatArray, name: str = "drive.csv", **more: FloatArray
) -> Recording:
    return recording_of({f"u{i}": x for i, x in enumerate(u.T)} | {"y": y} | more, name)


@pytest.mark.parametrize("first_lag", [0, 1])
def test_closed_loop_sensitivities_are_those_of_torch_through_time(first_lag: int) -> None:
    import torch  # takes seconds, which a worker without this test need not spend

    # GIVEN two pieces, one with unscored samples, and feedback that is clipped now and then
    spec = Spec(2, lags=3, hidden=(4, 3), input_lag_start=first_lag, y_min=-0.4, y_max=0.5)
    rng = RNG(2)
    weights, n = 1.5 * initial_weights(spec, rng), 60
    u, y, weight = rng.normal(size=(n, 2)), rng.normal(size=n), rng.uniform(0.5, 2.0, n)
    weight[20:24] = 0.0
    history = rng.uniform(-0.4, 0.5, size=(2, 3))
    pieces = Pieces(np.array([3, 30]), np.array([30, 60]), np.array([0, 5]), history)
    objective = ClosedLoop(spec, Samples(u, y, weight), pieces, dtype=np.float64)
    # WHEN the same free run is differentiated by torch
    w = torch.tensor(weights, requires_grad=True)
    total, rows, clipped = torch.zeros((), dtype=torch.float64), [], 0
    for piece in range(2):
        past = [torch.tensor(v) for v in history[piece]]
        for t in range(pieces.start[piece], pieces.stop[piece]):
            taps = [torch.tensor(u[t - j]) for j in range(first_lag, 4)]
            out = forward(spec, w, torch.cat([*taps, torch.stack(past)])[None], torch.tanh)[0]
            if t - pieces.start[piece] >= pieces.skip[piece] and weight[t] > 0:
                total = total + weight[t] * (out - y[t]) ** 2
                (grad,) = torch.autograd.grad(out, w, retain_graph=True)
                rows.append(np.sqrt(weight[t]) * grad.numpy())
            clipped += not spec.y_min < float(out.detach()) < spec.y_max
            past = [out.clamp(spec.y_min, spec.y_max), *past[:-1]]
    # THEN cost, rows and gradient agree
    J = np.concatenate([block.copy() for block, _ in objective.blocks(weights)])
    cost, hessian, gradient = objective.normal(weights)
    (by_torch,) = torch.autograd.grad(total, w)
    assert clipped > 3
    assert np.allclose(J, np.array(rows), atol=1e-11)
    assert cost == pytest.approx(float(total.detach()) / objective.total_weight, rel=1e-12)
    assert objective.cost(weights) == pytest.approx(cost, rel=1e-12)
    assert np.allclose(2 * gradient * objective.total_weight, by_torch.numpy(), atol=1e-9)
    assert np.allclose(hessian * objective.total_weight, J.T @ J, atol=1e-9)


def free_run_with_numpy_s_tanh(
    spec: Spec, weights: FloatArray, u: FloatArray, first: FloatArray
) -> FloatArray:
    y = np.concatenate([first, np.zeros(len(u) - spec.lags)])
    for t in range(spec.lags, len(u)):
        taps = u[t - spec.lags : t + 1 - spec.input_lag_start][::-1].ravel()
        x = np.concatenate([taps, y[t - spec.lags : t][::-1]])
        y[t] = np.clip(forward(spec, weights, x[None])[0], spec.y_min, spec.y_max)
    return y


@pytest.mark.parametrize("hidden", [(1,), (8, 8), (15,), (3, 17, 8)])
@pytest.mark.parametrize("gain", [1.0, 30.0])
def test_the_compiled_free_run_is_that_of_numpy(hidden: tuple[int, ...], gain: float) -> None:
    # GIVEN widths below, at and above one group of tanh, small sums and saturated ones
    spec, rng = Spec(2, lags=3, hidden=hidden, y_min=-2.0, y_max=2.0), RNG(20)
    weights, u, first = gain * initial_weights(spec, rng), rng.normal(size=(40, 2)), np.zeros(3)
    run = simulate(
        spec, weights, u=u, start=np.array([3]), stop=np.array([40]), history=first[None]
    )
    assert np.allclose(run[3:], free_run_with_numpy_s_tanh(spec, weights, u, first)[3:], atol=1e-9)


def test_weights_that_are_not_finite_cost_nan_in_free_run() -> None:
    spec = Spec(1, lags=2, hidden=(3,))
    samples = Samples(np.ones((9, 1)), np.ones(9), np.ones(9))
    loop = ClosedLoop(spec, samples, whole(spec, samples))
    assert np.isnan(loop.cost(np.full(spec.n_weights, np.nan)))


def whole(spec: Spec, samples: Samples) -> Pieces:
    """All samples as one piece."""
    n = len(samples.y)
    history = samples.y[None, spec.lags - 1 :: -1].copy()
    return Pieces(np.array([spec.lags]), np.array([n]), np.array([0]), history)


@pytest.mark.parametrize("closed", [False, True])
def test_float32_jacobians_sum_to_the_exact_normal_equations(closed: bool) -> None:
    # GIVEN more samples than one block holds, and unequal weights
    spec, rng = Spec(3, hidden=(6, 6), y_min=-3.0, y_max=3.0), RNG(3)
    u, y, weight = rng.normal(size=(4000, 3)), rng.normal(size=4000), rng.uniform(0, 2, 4000)
    samples, weights = Samples(u, y, weight), initial_weights(spec, rng)

    def normal(dtype: type[np.floating]) -> tuple[float, FloatArray, FloatArray]:
        if closed:
            return ClosedLoop(spec, samples, whole(spec, samples), dtype).normal(weights)
        return one_step(spec, samples, np.arange(5, 4000), dtype).normal(weights)

    # THEN no entry is off by more than a few roundings of the columns it is the product of
    cost, hessian, gradient = normal(np.float64)
    fast_cost, fast_hessian, fast_gradient = normal(np.float32)
    column = np.sqrt(np.diag(hessian))
    few = 10 * np.finfo(np.float32).eps
    assert fast_cost == pytest.approx(cost, rel=1e-6)
    assert np.all(np.abs(fast_hessian - hessian) <= few * np.outer(column, column))
    assert np.all(np.abs(fast_gradient - gradient) <= few * column * np.sqrt(cost))


def test_lm_recovers_a_system_that_the_network_contains() -> None:
    # GIVEN noise-free data of a NARX with three neurons
    spec, rng = Spec(1, lags=2, hidden=(3,), y_min=-5.0, y_max=5.0), RNG(5)
    truth, u = initial_weights(spec, rng), rng.uniform(-2, 2, size=(800, 1))
    y = np.zeros(800)
    y[2:] = simulate(
        spec, truth, u=u, start=np.array([2]), stop=np.array([800]), history=np.zeros((1, 2))
    )[2:]
    objective = one_step(spec, Samples(u, y, np.ones(800)), np.arange(2, 800))
    # WHEN it is trained from other weights THEN the error all but vanishes and never rises
    outcome = minimise(objective, initial_weights(spec, rng), epochs=300)
    assert outcome.costs[-1] < 1e-9 * np.var(y)
    assert np.all(np.diff(outcome.costs) < 0)


def test_closed_loop_tuning_beats_one_step_training_in_free_run() -> None:
    # GIVEN a slow plant whose measurement is noisy
    data = prepared(0.95, 3000)
    spec = Spec(2, 3, (5,), 0, *data.scaling.y_scaled_limits)
    # WHEN a network is trained one step ahead, and over growing horizons
    start = Trained(spec, seed=6)
    one, tuned = (train(data, start, horizons=horizons) for horizons in ((), HORIZONS))
    # THEN the free run of blocks that chose nothing is clearly better
    score = [blocks_of(data, spec, Role.TEST).score(each.weights) for each in (tuned, one)]
    assert score[0] < 0.7 * score[1]


def test_blocks_are_held_out_of_every_recording_and_never_overlap() -> None:
    rng = RNG(7)
    drives = [
        recording(rng.normal(size=(6000, 2)), rng.normal(size=6000), f"{i}.csv") for i in range(2)
    ]
    data = prepare(drives, ["u0", "u1"], "y")
    shares = [float(np.mean(data.role == role)) for role in Role]
    assert shares == pytest.approx([0.70, 0.15, 0.15], abs=0.05)
    for segment in data.segments:
        assert set(data.role[segment.start : segment.stop].tolist()) == {0, 1, 2}


def test_invalid_inputs_end_a_segment_and_invalid_outputs_are_not_scored() -> None:
    rng = RNG(8)
    u, y = rng.normal(size=(3000, 1)), rng.normal(size=3000)
    u[1000:1010] = np.nan
    y[2000:2005] = np.nan
    data = prepare([recording(u, y)], ["u0"], "y")
    found = [(s.first, s.first + s.stop - s.start) for s in data.segments]
    assert found == [(0, 1000), (1010, 3000)]
    assert int((data.samples.weight == 0).sum()) == 5
    assert np.isfinite(data.samples.y).all()


def test_fuel_cut_weighs_less_than_the_enabled_region() -> None:
    rng = RNG(9)
    cut = (np.arange(3000) % 100 < 20).astype(float)
    drive = recording(rng.normal(size=(3000, 1)), rng.normal(size=3000), fuel_cut=cut)
    data = prepare([drive], ["u0"], "y")
    assert np.array_equal(data.enabled, cut == 0)
    assert data.samples.weight[cut > 0].max() < data.samples.weight[cut == 0].min()


def test_a_lone_spike_is_an_outlier_and_a_step_is_not() -> None:
    rng = RNG(10)
    values = 0.01 * rng.standard_normal(500)
    values[200] = 5.0
    values[300:] += 3.0
    assert np.flatnonzero(outlier_mask("anything", values)).tolist() == [200]
    rail = outlier_mask("rail_pressure_mpa", np.array([5.0, 99.0, 5.0]))
    assert rail.tolist() == [False, True, False]


def test_unusable_recordings_are_refused_with_the_reason() -> None:
    rng = RNG(11)
    u, y = rng.normal(size=(2000, 2)), rng.normal(size=2000)
    u[:, 1] = 4.0
    constant = recording(u, y)
    with pytest.raises(RecordingError, match=r"drive\.csv: input u1 is constant"):
        prepare([constant], ["u0", "u1"], "y")
    with pytest.raises(RecordingError, match="has no u9"):
        prepare([constant], ["u9"], "y")
    with pytest.raises(UsageError, match="both an input and the output"):
        prepare([constant], ["u0", "y"], "y")
    with pytest.raises(RecordingError, match="no stretch of 40 samples"):
        prepare([recording(u[:20], y[:20])], ["u0"], "y")
    slow = replace(constant, path=Path("slow.csv"), period_ns=200_000_000)
    with pytest.raises(RecordingError, match=r"slow\.csv: sample period 0\.2 s"):
        prepare([constant, slow], ["u0"], "y")


def test_a_recording_of_which_nothing_can_be_used_is_told() -> None:
    u, y = RNG(13).normal(size=(2000, 1)), RNG(14).normal(size=2000)
    silent = recording(u, np.full(2000, np.nan), "silent.csv")
    (told,) = prepare([recording(u, y), silent], ["u0"], "y").warnings
    assert told.startswith("silent.csv: not used, no stretch of 40 samples")


def test_an_input_that_duplicates_the_output_is_reported() -> None:
    rng = RNG(12)
    y = rng.normal(size=2000)
    u = np.column_stack([rng.normal(size=2000), y + 1e-4 * rng.normal(size=2000)])
    data = prepare([recording(u, y)], ["u0", "u1"], "y")
    assert any("u1 nearly duplicates the output y" in w for w in data.warnings)


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


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize(
    ("rmse", "told"),
    [
        (0.5, "570 s left, best error 0.5000 standard deviations of the output"),
        (np.inf, "570 s left"),
    ],
)
def test_without_a_terminal_a_line_tells_best_error_and_time_left(rmse: float, told: str) -> None:
    # GIVEN a training whose progress goes to a file, with ten minutes of work
    clock, out = Clock(), io.StringIO()
    with Budget(10.0, out, clock) as bar:
        bar.spend(0.25 * PER_MINUTE)
        bar.tried(SimpleNamespace(rmse=rmse))  # type: ignore[arg-type]
        assert out.getvalue() == ""
        # WHEN half a minute has brought the work of half a minute
        clock.now_s = LINE_S
        bar.spend(0.25 * PER_MINUTE)
    # THEN one line tells the best error that is finite, and the rest of the budget
    assert out.getvalue() == f"training: 5 % done, {told}\n"


def test_the_time_left_follows_the_pace_and_ends_at_0() -> None:
    clock, out = Clock(), io.StringIO()
    with Budget(10.0, out, clock) as bar:
        # WHEN a busy machine has done two minutes of work in six THEN the rest takes 24
        for clock.now_s, minutes in ((360.0, 2.0), (500.0, 9.0)):
            bar.spend(minutes * PER_MINUTE)
    assert out.getvalue().splitlines() == [
        "training: 20 % done, 1440 s left",
        "training: 100 % done, 0 s left",
    ]


def test_steps_of_unknown_length_are_lines_where_there_is_no_terminal() -> None:
    clock, out = Clock(), io.StringIO()
    with Progress(out, clock, unit="step") as bar:
        for clock.now_s, text in ((1.0, "naming"), (40.0, "adding"), (50.0, "verifying")):
            bar.step(text)
    assert out.getvalue() == "o2train: adding\n"
