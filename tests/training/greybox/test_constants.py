"""The chain's constants, fitted from the reading."""

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from tests.helpers.models.chain_readings import TRUE, read_drive, synthetic
from training.greybox.fit.constants import Fitted, fit_constants, reference


def fitted_synthetic(seed: int) -> Fitted:
    return fit_constants(read_drive(*synthetic(seed)))


def test_the_constants_of_a_chain_are_found_within_their_standard_errors() -> None:
    # GIVEN drives of a chain with known constants and a slow noise
    fits = [fitted_synthetic(seed) for seed in range(10)]
    off = np.array([(np.array(f.constants) - TRUE) / f.standard_errors for f in fits])
    # THEN what was found lies about the truth as the standard errors say
    rms = np.sqrt(np.mean(off**2, axis=0))
    assert ((rms > 0.4) & (rms < 2.0)).all()
    gain, dead_time_s, *_, span = np.mean([f.standard_errors for f in fits], axis=0)
    assert (gain < 0.002, dead_time_s < 0.01, span < 0.02) == (True, True, True)
    assert not any(f.at_bound for f in fits)


def test_the_noise_is_whitened_and_every_start_ends_in_one_place() -> None:
    fit = fitted_synthetic(3)
    assert fit.noise_model == pytest.approx((1.3, -0.35), abs=0.06)
    assert fit.white_rmse == pytest.approx(0.002, rel=0.05)
    assert fit.rmse > 2 * fit.white_rmse
    assert fit.spread < 1e-3


def test_the_sum_of_the_lags_is_known_better_than_each() -> None:
    healthy = reference(fitted_synthetic(1))
    parts = healthy["constants"]
    assert healthy["derived"]["lag_s"]["value"] == pytest.approx(0.17, abs=0.02)
    assert healthy["derived"]["lag_s"]["standard_error"] < 0.5 * parts["mixing_s"]["standard_error"]


def test_a_reading_on_every_second_sample_is_refused_with_what_is_wanted() -> None:
    # GIVEN lambda at half the grid's rate, as exports of several rates have it
    signals, phi = synthetic(3)
    scored = np.arange(len(phi)) % 2 == 0
    # WHEN the chain, whose noise has a memory of two samples, is fitted
    with pytest.raises(RecordingError, match=r"^0 samples enabled .* on every sample of the grid"):
        fit_constants(read_drive(signals, phi, scored))
