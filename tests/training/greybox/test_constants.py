"""The chain's constants and its charge, fitted from the reading.

The charge is a map, or the broadcast one with its error.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.studies.workflow.drive import recording
from benchmarks.studies.workflow.plan import Part
from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.charge import ChargeError, ChargeMap, fit_with_charge
from training.greybox.fit.constants import Fitted, fit_constants, reference
from training.greybox.fit.drive import ChainDrive, from_recording, joined

PERIOD_S = 0.1

TRUE = Constants(
    gain=1.01, dead_time_s=0.17, dead_time_revolutions=1.5, mixing_s=0.05, sensor_s=0.12, span=0.95
)


def steps(rng: np.random.Generator, n: int, longest: int) -> NDArray[np.int64]:
    """Return which of steps of 5 samples and more each of n samples belongs to."""
    return np.searchsorted(np.cumsum(rng.integers(5, longest, n)), np.arange(n), side="right")


def synthetic(seed: int, n: int = 6000) -> tuple[dict[str, FloatArray], FloatArray]:
    """Signals and the reading of a chain with the constants TRUE and a slow noise."""
    rng = np.random.default_rng([seed, 7])
    hold = steps(rng, n, 25)
    mixture = (1.0 + 0.03 * rng.choice([-1.0, 1.0], n))[hold]
    signals = {
        "fuel_mass_mg": 300.0 / 14.7 * mixture,
        "air_mass_mg": np.full(n, 300.0),
        "engine_speed_rpm": rng.uniform(800.0, 3000.0, n)[hold],
    }
    noise = lfilter([1.0], [1.0, -1.3, 0.35], 0.002 * rng.standard_normal(n))
    return signals, simulate(base_path(TRUE, signals), PERIOD_S) + noise


def read_drive(
    signals: dict[str, FloatArray], phi: FloatArray, scored: BoolArray | None = None
) -> ChainDrive:
    """Return a drive of which all but the first 5 s are scored, or these samples."""
    if scored is None:
        scored = np.arange(len(phi)) >= 50
    return ChainDrive(
        name="some", period_s=PERIOD_S, signals=signals, phi_measured=phi, scored=scored
    )


def fitted_synthetic(seed: int) -> Fitted:
    return fit_constants(read_drive(*synthetic(seed)))


def errors_of(fitted: Fitted) -> list[float]:
    return [row["standard_error"] for row in fitted.rows.values()]


def test_the_constants_of_a_chain_are_found_within_their_standard_errors() -> None:
    # GIVEN drives of a chain with known constants and a slow noise
    fits = [fitted_synthetic(seed) for seed in range(10)]
    off = np.array([(np.array(f.constants) - TRUE) / errors_of(f) for f in fits])
    # THEN what was found lies about the truth as the standard errors say
    rms = np.sqrt(np.mean(off**2, axis=0))
    assert ((rms > 0.4) & (rms < 2.0)).all()
    gain, dead_time_s, *_, span = np.mean([errors_of(f) for f in fits], axis=0)
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
    with pytest.raises(RecordingError, match=r"^some: 0 samples enabled .* sample of the grid"):
        fit_constants(read_drive(signals, phi, scored))


def test_the_error_of_a_charge_is_found_from_the_reading_alone() -> None:
    # GIVEN a chain whose charge is wrong by speed and charge, which its ECU learns in four seconds
    n, rng = 20_000, np.random.default_rng(12)
    hold = steps(rng, n, 60)
    signals = {
        "air_mass_mg": rng.uniform(100.0, 600.0, n)[hold],
        "engine_speed_rpm": rng.uniform(800.0, 4000.0, n)[hold],
    }
    speeds, charges = np.linspace(700.0, 4100.0, 4), np.linspace(80.0, 620.0, 4)
    wrong = 0.02 * np.arange(4)[:, None] - 0.01 * np.arange(4)
    true = ChargeError(speeds, charges, wrong, -wrong, 4.0)
    air = true.air_mass_mg(signals, PERIOD_S)
    signals["fuel_mass_mg"] = air / 14.7 * (1.0 + 0.03 * rng.choice([-1.0, 1.0], n))[hold]
    phi = simulate(base_path(TRUE, signals | {"air_mass_mg": air}), PERIOD_S)
    phi += 0.002 * rng.standard_normal(n)
    # WHEN error and constants are fitted
    fitted, found = fit_with_charge(read_drive(signals, phi))
    # THEN the charge is right, on the whole up to the gain
    assert isinstance(found, ChargeError)
    assert found.time_s == 4.0
    off = found.air_mass_mg(signals, PERIOD_S) / air / fitted.constants.gain * TRUE.gain - 1.0
    assert np.abs(signals["air_mass_mg"] / air - 1.0).max() > 0.05
    assert np.quantile(np.abs(off), 0.99) < 0.01
    assert np.abs(np.array(fitted.constants) - TRUE)[1:].max() < 0.03


def test_the_charge_stays_plausible_where_the_engine_was_not_when_it_was_fitted() -> None:
    # GIVEN three drives of a simulated vehicle that hardly come near a full charge at idle speed
    starts_s = {"hwfet": 39.0, "micro_trips": 337.0, "wltc_3b": 0.0, "udds": 243.0, "us06": 0.0}
    parts = [Part(k, 22_013_000 + i, at_s, None) for i, (k, at_s) in enumerate(starts_s.items())]
    made = [from_recording(recording(part, 10013, 600.0, {}, None)) for part in parts]
    # WHEN error and constants are fitted to them
    fitted, found = fit_with_charge(joined(made[:3]))
    # THEN it helps on drives that go anywhere
    assert found is not None
    for each in made[3:]:
        right = {"air_mass_mg": found.air_mass_mg(each.signals, PERIOD_S)}
        broadcast, corrected = (
            simulate(base_path(fitted.constants, signals), PERIOD_S) - each.phi_measured
            for signals in (each.signals, dict(each.signals) | right)
        )
        assert corrected[each.scored].std() < 0.8 * broadcast[each.scored].std()


def test_a_charge_that_is_right_has_no_error_worth_a_map() -> None:
    signals, phi = synthetic(4)
    _, found = fit_with_charge(read_drive(signals, phi))
    right = signals["air_mass_mg"]
    made = right if found is None else found.air_mass_mg(signals, PERIOD_S)
    assert np.abs(made / right - 1.0).max() < 0.01


def test_a_charge_map_is_found_from_the_reading_alone() -> None:
    # GIVEN a chain whose efficiency falls with speed and rises with pressure
    n, rng = 8000, np.random.default_rng(11)
    hold = steps(rng, n, 25)
    signals = {
        "manifold_pressure_kpa": rng.uniform(20.0, 150.0, n)[hold],
        "manifold_temperature_degc": rng.uniform(10.0, 60.0, n)[hold],
        "engine_speed_rpm": rng.uniform(800.0, 4000.0, n)[hold],
    }
    speeds, pressures = np.linspace(700.0, 4100.0, 4), np.linspace(15.0, 160.0, 4)
    true = ChargeMap(speeds, pressures, 1.2 + 0.05 * np.arange(4)[:, None] - 0.03 * np.arange(4))
    air = true.air_mass_mg(signals)
    signals["fuel_mass_mg"] = air / 14.7 * (1.0 + 0.03 * rng.choice([-1.0, 1.0], n))[hold]
    constants = TRUE._replace(gain=1.0)
    phi = simulate(base_path(constants, signals | {"air_mass_mg": air}), PERIOD_S)
    phi += 0.002 * rng.standard_normal(n)
    # WHEN map and constants are fitted
    fitted, found = fit_with_charge(read_drive(signals, phi))
    # THEN both are right
    assert isinstance(found, ChargeMap)
    off = np.abs(found.air_mass_mg(signals) / air - 1.0)
    assert np.median(off) < 0.001
    assert np.quantile(off, 0.99) < 0.01  # corners are hardly driven
    assert np.abs(np.array(fitted.constants) - constants).max() < 0.02
