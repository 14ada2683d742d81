"""Healthy errors on a drive with an effect are those of the same mixture without it."""

from dataclasses import replace

import numpy as np

from tests.helpers.gap.gap_simulated import known, simulated
from training.greybox.effects.model_effect import ModelEffect
from training.healthy.without import LIMITS, corrections


def test_an_effect_on_the_mixture_is_taken_out_of_fuel_and_controller() -> None:
    # GIVEN an effect that makes the mixture richer by 5 % wherever the engine runs
    richer = ModelEffect.with_values("empirical:engine_speed_rpm:factor:2000:1000", [5.0, 0.0])
    drive = known().known_of(simulated("hwfet", 2_020_019))
    # WHEN the healthy errors are asked for without it
    (read,) = corrections(known(), [drive], (richer,))
    # THEN they are those of a drive with 5 % more fuel, and a controller that asks for it
    share = np.where(drive.signals["fuel_mass_mg"] > LIMITS.controller_fuel_min_mg, 1.05, 1.0)
    moved = {n: share * drive.signals[n] for n in ("fuel_mass_mg", "lambda_controller")}
    like = replace(drive, signals={**drive.signals, **moved})
    np.testing.assert_allclose(read, known().correction(like), atol=1e-9)
    assert not np.allclose(read, known().correction(drive), atol=1e-4)
    # AND without any effect they are the drive's own
    (same,) = corrections(known(), [drive], ())
    np.testing.assert_allclose(same, known().correction(drive))
