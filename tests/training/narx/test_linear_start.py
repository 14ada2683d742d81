"""The linear model among the starts: it equals its ARX, and it tells the memory of the samples."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.helpers.drives.recordings import recording_of
from training.narx.linear.arx import Arx, choose_arx
from training.narx.linear.free_run import free_runs
from training.narx.network import Spec, simulate
from training.narx.search.linear_start import as_network, linear_starts, stretches, with_memory
from training.narx.search.stages import (
    Trained,
    free_run_score,
    measured_history,
    pieces,
    random_pieces,
)
from training.narx.search.starts import choose, committee
from training.narx.work import Work
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


def small_arx(data: Prepared) -> Arx:
    return choose_arx(stretches(data, Role.TRAIN), stretches(data, Role.VALIDATE), 3)


def test_the_first_network_runs_as_its_arx_does() -> None:
    data = prepared(0.8)
    arx = Arx(np.array([-0.5, -0.1]), np.array([[0.2, 0.1], [-0.3, 0.4]]), (0, 3), 0.05)
    spec, weights = as_network(arx, data)
    start, stop = np.array([40]), np.array([400])
    history = measured_history(data, spec.lags, start)
    own = simulate(spec, weights, u=data.samples.u, start=start, stop=stop, history=history)
    wanted = arx.simulate(data.samples.u[:400], data.samples.y[:40])
    np.testing.assert_allclose(own[40:400], wanted[40:], atol=1e-12)


def test_a_fit_has_the_arx_among_its_starts_and_never_chooses_worse() -> None:
    data = prepared(0.8)
    arx = small_arx(data)
    plain, further = linear_starts([data], arx, Work())
    assert further.score <= plain.score
    rng = np.random.default_rng(0)
    poor = Spec(2, 2, (3,), 0, *data.scaling.y_scaled_limits)
    network = Trained(poor, 0.1 * rng.normal(size=poor.n_weights), 2.0 * plain.score)
    assert choose(data, (network, plain, further), 0)[0] > 0
    network.score = 0.5 * further.score
    assert choose(data, (network, plain, further), 0)[0] == 0


def test_a_committee_comes_before_the_best_start_unless_it_is_surely_worse() -> None:
    data = prepared(0.8)
    spec = Spec(2, 2, (3,), 0, *data.scaling.y_scaled_limits)

    def constant(*values: float) -> Trained:
        """Return the committee of networks that predict a constant each, one training for one."""
        members = [np.append(np.zeros(spec.n_weights - 1), value) for value in values]
        shape, weights = committee(spec, members)
        score = free_run_score(data, shape, weights)
        return Trained(shape, weights, score, members=len(values))

    # GIVEN a start below the output's average, a mean as far above it, and one far away
    average = float(data.samples.y[data.role == Role.VALIDATE].mean())
    start, mean = constant(0.0), constant(average, 3.2 * average)
    poor = constant(0.0, 20.0)
    assert start.score < mean.score < poor.score
    # WHEN one is chosen THEN it is the mean, as far as the blocks do not tell it from the start
    assert choose(data, (start, mean), 0)[0] == 1
    assert choose(data, (start, poor), 0)[0] == 0


def test_a_linear_model_that_remembers_does_not_come_before_a_network_that_forgets() -> None:
    # GIVEN samples with a memory of 50, a network that feeds nothing back, and a slow linear model
    data = replace(prepared(0.8), memory=50)
    own = Spec(2, 1, (3,), 0, *data.scaling.y_scaled_limits)
    network = Trained(own, np.zeros(own.n_weights), 1.0)
    arx = Arx(np.array([-0.999]), np.array([[0.1], [0.1]]), (0, 0), 0.0)
    slow = Trained(*as_network(arx, data), 0.9)
    # WHEN the linear model is a little better THEN the network is the model
    assert choose(data, (network, slow), 0)[0] == 0
    # and where neither forgets, or no network was trained, the linear model is
    network.score = np.inf
    assert choose(data, (network, slow), 0)[0] == 1


def test_a_network_must_forget_after_twice_the_time_of_the_linear_model() -> None:
    data = prepared(0.95)  # 0.95^100 is 0.006, a hundredth of the range of phi
    arx = small_arx(data)
    longer = with_memory(data, arx)
    assert longer.memory == pytest.approx(200, rel=0.3)
    # WHEN stretches begin with random histories THEN they are scored after the memory
    spec = Spec(2, 1, (3,), 0, -3.0, 3.0)
    found = random_pieces(longer, spec, np.random.default_rng(0), 2000.0)
    assert len(found.start) > 0
    assert found.skip[0] < longer.memory < found.stop[0] - found.start[0]
    assert len(random_pieces(data, spec, np.random.default_rng(0), 2000.0).start) == 0


def test_blocks_too_short_to_show_the_memory_ask_for_none() -> None:
    data = prepared(0.97, 1400)
    arx = small_arx(data)
    assert data.longest_block < 500
    assert with_memory(data, arx).memory == 0
    assert pieces(data, Spec(2, 1, (3,), 0), 50).skip.max() == 0


def test_lambda_without_fuel_may_be_slow_and_with_fuel_is_forgotten_within_a_window() -> None:
    # GIVEN lambda of a slow linear model, from inputs that do not tell the fuel
    data = replace(prepared(0.95), memory=50)
    arx = small_arx(data)
    assert with_memory(data, arx).memory == pytest.approx(200, rel=0.3)
    # WHEN fuel is an input THEN the mixture follows from it at once
    fuel = replace(data.inputs[0], name="fuel_mass_mg")
    assert with_memory(replace(data, inputs=(fuel, *data.inputs[1:])), arx).memory == 50


def test_lambda_must_be_forgotten_within_the_longest_time_that_blocks_show() -> None:
    data = replace(prepared(0.97, 1400), memory=50)
    asked = with_memory(data, small_arx(data)).memory
    assert 50 < asked <= data.longest_block / 1.6


def test_a_linear_model_that_integrates_has_no_memory() -> None:
    data = prepared(0.8)
    integrator = Arx(np.array([-1.0]), np.array([[0.1], [0.1]]), (1, 1), 0.0)
    assert with_memory(data, integrator) is data


def test_a_stretch_as_short_as_its_start_is_all_measured() -> None:
    # GIVEN a model without memory of its output, and a stretch between two readings left out
    model = Arx(delays=(0,), b=np.array([[0.5]]), a=np.zeros(0), offset=0.0)
    short, long = np.ones((3, 1)), np.ones((5, 1))
    # WHEN both run freely behind three measured samples
    runs = free_runs(model, [(short, np.full(3, 2.0)), (long, np.full(5, 2.0))], skip=3)
    # THEN the short one is what was measured
    assert [run.tolist() for run in runs] == [[2.0, 2.0, 2.0], [2.0, 2.0, 2.0, 0.5, 0.5]]
