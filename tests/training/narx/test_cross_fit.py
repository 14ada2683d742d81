"""The free run over recordings by twins that did not see them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from monitor.base.types import FloatArray
from tests.training.narx.test_fit import plant, source_of
from training.narx.cross_fit import CrossFit, cross_fit
from training.narx.fit import FitOptions, fit
from training.narx.network import Spec
from training.narx.work import Work
from training.recordings.samples.preparation import Prepared


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
