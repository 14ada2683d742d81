"""Counts over a recording: the same wherever blocks begin, alone or together."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import Quality
from monitor.judge.causes.observation import Observation
from monitor.judge.enable import Enable
from monitor.model.card import Channel
from tests.helpers.examples import inputs

CONFIG = config.load()
NAMES = ("air_mass_mg", "lambda_measured", "vehicle_speed_km_h")
N = 2500


def enable() -> Enable:
    air = Channel(NAMES[0], "mg", 100.0, 600.0, 100.0, 600.0)
    return Enable(CONFIG.enable, NAMES, [air], "lambda_measured", 0.1)


def drive() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    values = rng.uniform((50.0, 0.9, 0.0), (650.0, 1.1, 20.0), (N, 3))
    quality = np.zeros((N, 3), dtype=np.uint8)
    quality[rng.random((N, 3)) < 0.1] = Quality.INVALID
    quality[:, 2] = np.where(np.arange(N) % 20 < 10, Quality.STALE, quality[:, 2])
    values[quality > 0] = np.nan
    return values, quality


def observed(cuts: list[int]) -> Observation:
    subject = enable()
    observation = Observation(subject, NAMES, CONFIG.plausibility, 0.1)
    values, quality = drive()
    for begin, end in zip([0, *cuts], [*cuts, N], strict=True):
        part = slice(begin, end)
        observation.push(values[part], quality[part], subject.push(values[part]))
    return observation.observed()


@inputs(15)
@given(st.lists(st.integers(1, N - 1), unique=True, max_size=30).map(sorted))
def test_no_count_depends_on_where_blocks_begin(cuts: list[int]) -> None:
    whole, parts = vars(observed([])).values(), vars(observed(cuts)).values()
    for expected, got in zip(whole, parts, strict=True):
        np.testing.assert_equal(expected, got)


def test_the_counts_are_those_of_the_samples() -> None:
    values, quality = drive()
    seen = observed([700])
    assert seen.samples == N
    assert seen.quality[Quality.STALE].tolist() == [0, 0, N / 2]
    assert seen.stale_runs.tolist() == [0, 0, N / 20]
    assert seen.low[1] == np.nanmin(values[:, 1])
    air = next(i for i, each in enumerate(seen.ranges) if each.signal == "air_mass_mg")
    assert seen.below[air] == np.count_nonzero(values[:, 0] < 50.0)
    assert seen.share("measured_valid") == np.mean(quality[:, 1] == Quality.GOOD)
