"""Folds: every training leaves one out, and the mean of all has seen every sample."""

import numpy as np
from scipy.signal import lfilter

from tests.helpers.drives.recordings import recording_of
from training.narx.search.folds import fold, groups_of, withheld
from training.narx.search.mean import choose
from training.narx.search.stages import blocks_of
from training.narx.search.structure import Search
from training.narx.work import PER_MINUTE, Work
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


def folds(data: Prepared) -> list[Prepared]:
    return [fold(data, rows & ~rows, rows) for rows in groups_of(data)]


def test_the_mean_of_trainings_with_all_samples_is_better_on_another_drive_than_most() -> None:
    # GIVEN the trainings of a search, each without a quarter of the drive
    data = prepared(0.9, 1200)
    search = Search(folds(data), 0, 1)
    search.run(Work(0.02 * PER_MINUTE))
    search.train_members(Work())
    assert {each.fold for each in search.members} == set(range(4))
    # WHEN they are trained on with all of it and joined THEN the mean follows another drive
    everything = fold(data, *np.zeros((2, len(data.role)), dtype=bool))
    members = search.refitted(everything, Work(), 4)
    mean = choose(everything, members, 0, Work(), join=True).model
    assert mean.members == 4
    other = prepare([drive(0.9, 1200, seed=2)], ["u0", "u1"], "y")
    unseen = [blocks_of(other, t.spec, Role.TRAIN).score(t.weights) for t in (mean, *members)]
    assert unseen[0] < np.median(unseen[1:])


def test_a_fold_leaves_out_whole_recordings_or_blocks_of_a_single_one() -> None:
    drives = [drive(0.9, 600, seed) for seed in range(6)]
    data = prepare(drives, ["u0", "u1"], "y")
    owner = np.repeat(range(6), 600)
    groups = [np.unique(owner[rows]).tolist() for rows in groups_of(data)]
    assert groups == [[0, 1], [2, 3], [4], [5]]
    alone = [np.flatnonzero(rows)[::150].tolist() for rows in groups_of(prepared(0.9, 1200))]
    assert alone == [[0, 600], [150, 750], [300, 900], [450, 1050]]


def test_samples_that_limits_need_are_withheld_from_every_training() -> None:
    short, middle, long = (prepared(0.9, n) for n in (1200, 2800, 4600))
    assert not withheld(short).any()  # both together are too short for limits
    assert np.array_equal(withheld(middle), middle.role != Role.TRAIN)
    assert np.array_equal(withheld(long), long.role == Role.TEST)
    kept = withheld(long)
    assert not fold(long, kept, ~kept).samples.weight[kept].any()
