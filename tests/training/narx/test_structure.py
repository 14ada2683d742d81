"""The choice of memory and size by the data, and what it needs: boxed lags and a linear path."""

from dataclasses import replace
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
from tests.training.narx.test_fit import plant, source_of
from training.narx.algorithms.objectives import ClosedLoop, Pieces, Samples, one_step
from training.narx.cross_fit import CrossFit, cross_fit
from training.narx.fit import FitOptions, FitResult, FitSource, fit
from training.narx.network import Spec, describe, forward, initial_weights, regressors
from training.narx.search.mean import choose, mean_of
from training.narx.search.stages import Trained, blocks_of, free_run
from training.narx.search.structure import Search, Structure, boxes, folds_of
from training.narx.work import PER_MINUTE, Work
from training.recordings.recording import Recording, load
from training.recordings.samples.preparation import Prepared, Role, prepare

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


def run_over(found: CrossFit, number: int) -> FloatArray:
    """Return the unseen free run over a recording's only stretch in model units."""
    (s,) = (s for s in found.data.segments if s.recording == number)
    run = np.full(len(found.data.recordings[number].values), np.nan)
    run[s.first : s.first + s.stop - s.start] = found.predicted[s.start : s.stop]
    return run


def shape(data: Prepared) -> Spec:
    return Spec(len(data.inputs), 2, (3,), 1, *data.scaling.y_scaled_limits)


def test_what_a_recording_holds_does_not_reach_its_unseen_prediction() -> None:
    # GIVEN three drives, and the same with another mixture measured in the second
    data = source_of(plant(1, 1200), plant(2, 1200), plant(3, 1200)).prepared(2, 0)
    y, second = data.samples.y.copy(), next(s for s in data.segments if s.recording == 1)
    y[second.start + 100 : second.stop] *= -1.0
    other = replace(data, samples=replace(data.samples, y=y))
    # WHEN both are cross-fitted
    found, changed = (cross_fit(d, shape(d), work=Work(2e7)) for d in (data, other))
    # THEN the twin without the second drive predicts the same, the others do not
    assert np.array_equal(run_over(found, 1), run_over(changed, 1), equal_nan=True)
    assert not np.array_equal(run_over(found, 0), run_over(changed, 0), equal_nan=True)


def test_a_single_recording_is_predicted_block_by_block() -> None:
    data = source_of(plant(1, 2500)).prepared(2, 0)
    found = cross_fit(data, shape(data))
    rows = np.array([twin.rows for twin in found.twins])
    assert [twin.network.spec.hidden for twin in found.twins] == [(9,)] * 4  # of three trainings
    assert (rows.sum(axis=0) == 1).all()
    assert np.isfinite(found.predicted).sum() > 2400


def test_the_card_names_the_worst_unseen_recording(tmp_path: Path) -> None:
    # GIVEN three drives, in one of which the sensor reads nonsense
    odd = plant(3, 1200)
    reading = odd.values[7:, 2]
    reading[:] = np.random.default_rng(0).permutation(reading)
    # WHEN a model is fitted
    options = FitOptions(lags=2, hidden=(3,), starts=1)
    found = fit(source_of(plant(1, 1200), plant(2, 1200), odd), tmp_path / "m.onnx", options)
    # THEN its card says how badly the odd one is predicted unseen
    unseen = found.card.fit["unseen"]
    assert [each["path"] for each in unseen["recordings"]] == [f"drive{i}.csv" for i in (1, 2, 3)]
    assert min(unseen["recordings"], key=lambda r: r["fit_percent"])["path"] == "drive3.csv"


def test_a_twin_as_a_model_runs_as_it_did_in_the_training(tmp_path: Path) -> None:
    options = FitOptions(lags=2, hidden=(3,), starts=1)
    drives = plant(1, 1200), plant(2, 1200)
    found = fit(source_of(*drives), tmp_path / "m.onnx", options)
    for model, parts in found.unseen.unseen(found.card):
        (drive,) = parts
        number = int(drive.path.name[len("drive")]) - 1
        run = run_over(found.unseen, number)[: len(drive.values)]
        u = drive.values[:, [drive.names.index(name) for name in found.card.input_names]]
        model.reset(u[0])
        phi, newest = np.empty(len(u)), model.card.state.output_start
        for k, row in enumerate(u):
            model.step(row)
            phi[k] = model.state[0, newest]
        both = np.isfinite(run)
        both[:50] = False  # they begin from other histories
        assert both.sum() > 1000
        assert np.abs(phi - run)[both].max() < 1e-5
