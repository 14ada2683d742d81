"""The grey-box chain as arrays: mixture, transport, mixing, sensor; and the sensor's faults."""

import numpy as np
import pytest

from monitor.base import faults
from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import BASE, PERIOD_S, plain_signals
from training.greybox.chain import STOICHIOMETRIC, Constants, Path, base_path, simulate, valve_phi
from training.greybox.fit.sensor_faults import FAULTS


def signals(phi: FloatArray, rpm: float = 1500.0) -> dict[str, FloatArray]:
    n = len(phi)
    return {
        "fuel_mass_mg": 300.0 / STOICHIOMETRIC * phi,
        "air_mass_mg": np.full(n, 300.0),
        "engine_speed_rpm": np.full(n, rpm),
    }


def path(phi: FloatArray, rpm: float = 1500.0, **constants: float) -> Path:
    return base_path(Constants(**constants), signals(phi, rpm))


def test_a_steady_mixture_is_read_with_gain_and_span() -> None:
    phi = simulate(path(np.full(30, 1.02), gain=1.01, span=0.9), PERIOD_S)
    assert np.allclose(phi, 1.0 + 0.9 * (1.01 * 1.02 - 1.0), atol=1e-12)


def test_fuel_cut_reads_zero_and_what_follows_is_late() -> None:
    phi = np.r_[np.ones(20), np.zeros(30), np.ones(30)]
    read = simulate(path(phi), PERIOD_S)
    assert read[20] == pytest.approx(1.0)  # the dead time of 0.21 s
    assert read[49] == pytest.approx(0.0, abs=1e-6)
    assert read[51] < 0.01
    assert read[70] > 0.99


@pytest.mark.parametrize(
    ("period_s", "rpm"), [(0.01, 1500.0), (0.1, 1500.0), (0.1, 750.0), (0.1, 3000.0)]
)
def test_a_ramp_is_late_by_dead_time_and_both_lags_at_any_sample_period_and_speed(
    period_s: float, rpm: float
) -> None:
    # GIVEN a mixture that grows by 0.02 per second
    n = round(8.0 / period_s)
    phi = 1.0 + 0.02 * period_s * np.arange(n)
    constants = {"dead_time_s": 0.13, "dead_time_revolutions": 1.5, "mixing_s": 0.06}
    read = simulate(path(phi, rpm, sensor_s=0.11, **constants), period_s)
    # THEN the reading runs behind by the dead time, 1.5 revolutions of it, and both lags
    late_s = 0.13 + 1.5 * 60.0 / rpm + 0.06 + 0.11
    assert phi[-1] - read[-1] == pytest.approx(0.02 * late_s, abs=1e-9)


def test_the_sensor_takes_the_time_constant_of_its_direction() -> None:
    step = np.r_[np.ones(10), np.full(50, 1.1), np.ones(50)]
    even = path(step, dead_time_s=0.0, dead_time_revolutions=0.0)
    slow = np.full(len(step), 0.5)
    fields = {name: getattr(even, name) for name in Path.__slots__}
    falling = simulate(Path(**(fields | {"sensor_falling_s": slow})), PERIOD_S)
    rising = simulate(Path(**(fields | {"sensor_rising_s": slow})), PERIOD_S)
    same = simulate(even, PERIOD_S)
    assert np.allclose(falling[:60], same[:60], atol=1e-12)  # rich edge unchanged
    assert falling[65] - same[65] > 0.02  # lean edge late
    assert same[15] - rising[15] > 0.02
    assert np.allclose(rising[90:], same[90:], atol=1e-4)


def test_what_the_gas_becomes_at_the_sensor_enters_after_mixing() -> None:
    even = path(np.ones(40))
    fields = {name: getattr(even, name) for name in Path.__slots__}
    changed = Path(**(fields | {"gas_factor": np.r_[np.ones(20), np.full(20, 0.95)]}))
    read = simulate(changed, PERIOD_S)
    assert read[19] == pytest.approx(1.0)
    assert read[20] < 1.0  # no dead time lies between
    assert read[-1] == pytest.approx(0.95, abs=1e-4)


def test_the_readings_stay_within_what_a_sensor_can_say() -> None:
    rng = np.random.default_rng(0)
    read = simulate(path(rng.uniform(0.0, 9.0, 500), span=1.4), PERIOD_S)
    assert read.min() >= 0.0
    assert read.max() == 1.7
    standing = {name: np.zeros(5) for name in signals(np.ones(5))}
    assert np.isfinite(simulate(base_path(Constants(), standing), PERIOD_S)).all()


def test_the_chain_forgets_its_start_within_fifty_samples() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0.9, 1.1, (2, 120))
    b[20:] = a[20:]
    read = [simulate(path(x), PERIOD_S) for x in (a, b)]
    assert np.abs(read[0] - read[1])[20:25].max() > 1e-3
    assert np.abs(read[0] - read[1])[70:].max() < 1e-6


def test_without_a_charge_signal_air_meter_and_engine_speed_give_it() -> None:
    given = signals(1.0 + 0.002 * np.arange(80))
    metered = {name: x for name, x in given.items() if name != "air_mass_mg"}
    metered["maf_kg_h"] = 300.0 * 1e-6 * 3600.0 * 2.0 * given["engine_speed_rpm"] / 60.0
    assert np.allclose(
        valve_phi(base_path(Constants(), metered)), valve_phi(base_path(Constants(), given))
    )


def test_the_two_lags_read_the_same_in_either_order() -> None:
    phi = 1.0 + 0.05 * np.random.default_rng(2).standard_normal(200)
    a, b = (
        simulate(path(phi, mixing_s=m, sensor_s=s), PERIOD_S) for m, s in ((0.3, 0.1), (0.1, 0.3))
    )
    assert np.allclose(a, b, atol=1e-12)


FAULT = {fault.name: fault for fault in FAULTS}


@pytest.mark.parametrize(
    ("name", "severity"),
    [
        ("slow_rich_to_lean", 0.4),
        ("slow_lean_to_rich", 0.4),
        ("slow_symmetric", 0.4),
        ("delay_rich_to_lean", 0.4),
        ("delay_lean_to_rich", 0.4),
        ("delay_symmetric", 0.4),
        ("gain_low", 0.6),
        ("biased_lean", 0.05),
    ],
)
def test_a_sensor_fault_reads_as_the_monitors_definition_does(name: str, severity: float) -> None:
    phi = simulate(base_path(BASE, plain_signals()), PERIOD_S)
    fault = faults.resolve(name, severity)
    rival = FAULT["biased" if name.startswith("biased") else name]
    ours = rival.read(phi, np.array([severity]), PERIOD_S)
    steps = round(fault.delay_s / PERIOD_S)
    slow, wanted = phi[0], np.empty_like(phi)
    for k in range(len(phi)):
        u = faults.one_sided(phi[k], phi[max(k - steps, 0)], fault.delay_direction)
        slow = faults.lag_step(slow, u, fault.tau_rising_s, fault.tau_falling_s, PERIOD_S)
        reading = 1.0 / max(1.0 + fault.gain * (slow - 1.0), 1.0 / 16.0) + fault.offset_lambda
        wanted[k] = 1.0 / min(max(reading, 0.5), 16.0)
    above = wanted > 0.07  # the monitor sends no more than 16 in lambda
    np.testing.assert_allclose(ours[above], wanted[above], atol=1e-9)
