"""Effects of the simulated dynamometer that a model may lack."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.errors import UsageError
from tests.helpers.drives.simulated_drives import FAULT_DRIVE, driven, rms, to_grid
from training.dyno import effects
from training.dyno.effects import Effects
from training.dyno.simulation import Experiment, simulate

NOISE_PHI = 0.004
GAP_DRIVE = Experiment(duration_s=900.0)


def gap_phi(experiment: Experiment, hidden: Effects) -> float:
    """RMS of what the effect does to measured phi, the controller's output being replayed."""
    with_effect = simulate(replace(experiment, effects=hidden))
    without = simulate(replace(experiment, forced_trim=with_effect["lambda_controller"]))
    np.testing.assert_array_equal(with_effect["closed_loop"], without["closed_loop"])
    closed = to_grid(with_effect["closed_loop"]) == 1.0
    phi = [to_grid(1.0 / s["lambda_measured"])[closed] for s in (with_effect, without)]
    return rms(phi[0] - phi[1])


@pytest.mark.parametrize("name", effects.NAMES)
def test_an_effect_of_severity_1_makes_a_gap_of_about_the_noise(name: str) -> None:
    gap = gap_phi(GAP_DRIVE, effects.from_severities({name: 1.0}))
    assert NOISE_PHI / 2.5 < gap < NOISE_PHI * 2.5


def test_without_an_effect_there_is_no_gap() -> None:
    assert gap_phi(replace(GAP_DRIVE, duration_s=300.0), Effects()) == 0.0


@pytest.mark.parametrize("name", ["wall_film", "maf_offset", "ethanol", "mix_flow"])
def test_a_larger_severity_makes_a_larger_gap(name: str) -> None:
    experiment = replace(FAULT_DRIVE, seed=4)
    gaps = [gap_phi(experiment, effects.from_severities({name: s})) for s in (0.5, 1.0, 2.0)]
    assert gaps[0] * 1.3 < gaps[1]
    assert gaps[1] * 1.3 < gaps[2]


def test_the_controller_hides_an_effect_in_its_correction() -> None:
    hidden = effects.from_severities({"ethanol": 8.0})
    plain, ethanol = (driven(replace(FAULT_DRIVE, effects=e)) for e in (Effects(), hidden))
    late = slice(20_000, None)
    on = (plain["closed_loop"][late] > 0.5) & (ethanol["closed_loop"][late] > 0.5)
    phi = [1.0 / s["lambda_measured"][late][on].mean() for s in (plain, ethanol)]
    trim = [s["lambda_controller"][late][on].mean() for s in (plain, ethanol)]
    assert abs(phi[1] - phi[0]) < 0.01
    assert trim[1] - trim[0] > 0.02


def test_an_unknown_effect_is_an_error_that_says_which_there_are() -> None:
    with pytest.raises(UsageError, match=r"'wallfilm' is unknown.*wall_film"):
        effects.from_severities({"wallfilm": 1.0})


def test_every_effect_has_a_scale() -> None:
    assert all(scale > 0.0 for scale in effects.SCALE)
    assert effects.from_severities({"purge": 2.0}).purge == 2.0 * effects.SCALE.purge
    assert effects.from_severities({}) == Effects()
