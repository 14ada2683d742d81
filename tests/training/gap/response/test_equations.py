"""How new runs' share of a fit is compared with that of healthy ones."""

from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.response.equations import Held, two_sided

BLOCKS: Final = 40
NEW, HEALTHY = np.arange(5), np.arange(5, 12)


def held(slopes: FloatArray, power: FloatArray, seed: int = 0) -> Held:
    """Runs with these slopes and this power in each block; an error of 0.3 times its root."""
    rng = np.random.default_rng(seed)
    each = np.repeat(power, BLOCKS)
    noise = 0.3 * np.sqrt(each) * rng.standard_normal(len(each))
    run = np.repeat(np.arange(12), BLOCKS)
    return Held(np.repeat(slopes, BLOCKS) * each + noise, each, NEW, HEALTHY, run, np.ones(1))


def test_runs_that_show_an_effect_to_different_extent_agree_on_it() -> None:
    slopes = np.repeat([1.0, 0.0], [5, 7])
    alike = held(slopes, np.ones(12)).t
    unlike = held(slopes, np.tile([0.2, 3.0, 0.5, 1.0], 3)).t
    assert unlike > 0.7 * alike > 7.0


def test_a_run_that_does_not_show_the_effect_has_no_say() -> None:
    slopes, power = np.repeat([1.0, 0.0], [5, 7]), np.ones(12)
    without = held(slopes, np.where(np.arange(12) == 2, 1e-12, power))
    assert without.t > 7.0


def test_fits_to_each_other_of_runs_without_an_effect_are_rarely_beyond_chance() -> None:
    rng, wrong = np.random.default_rng(0), []
    for _ in range(400):
        own = rng.standard_normal((12, 3))  # every run differs in its own way, in three columns
        new = own[:5] - own[5:].mean(axis=0)
        fits = np.array([np.delete(new, i, axis=0).mean(axis=0) for i in range(5)])
        usual = np.array([np.delete(own[5:], i, axis=0).mean(axis=0) for i in range(7)])
        fits = np.concatenate([fits, np.tile(new.mean(axis=0), (7, 1))])
        own = np.concatenate([new, own[5:] - usual])
        cross, power = (own * fits).sum(axis=1), (fits**2).sum(axis=1)
        wrong.append(Held(cross, power, NEW, HEALTHY, np.arange(12), np.ones(3)).t)
    assert np.mean(np.array(wrong) > 2.764) < 0.02  # Student's t, 10 degrees: 0.01


def test_two_groups_alike_by_chance_are_as_unsure_as_their_blocks() -> None:
    t = two_sided(np.ones(5), np.full(5, 1.0), np.zeros(7), np.full(7, 1.0))
    assert np.isclose(t, 1.0 / np.sqrt(1 / 5 + 1 / 7))
