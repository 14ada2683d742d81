"""Faults as defined: in phi = 1/lambda, rising phi is lean to rich; and the bank that agrees."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.errors import UsageError
from monitor.base.faults import NAMES, TRANSIENT_GAIN, Fault, resolve
from monitor.judge.response.bank import DIRECTIONS, build
from monitor.memory.codes import CODES
from tests.helpers.examples import inputs
from tests.helpers.models.windows import readings
from training.cli.simulate import combined
from training.dyno.downstream import FAULTS
from training.recordings.sensor_fault import faulty_readings

PERIOD_S = 0.1
CLOSE = 1e-12

phis = st.lists(st.floats(0.1, 1.9), min_size=2, max_size=80)
lags_s = st.floats(0.05, 3.0)
delays = st.integers(1, 25)  # samples


def read(fault: Fault, phi: list[float], period_s: float = PERIOD_S) -> np.ndarray:
    """What the faulty sensor reads of a healthy phi, as phi."""
    return 1.0 / faulty_readings(fault, 1.0 / np.array(phi), period_s)


@given(phis, lags_s, st.sampled_from(DIRECTIONS))
def test_a_lag_is_the_first_order_step_response_on_the_edges_of_its_direction(
    phi: list[float], tau_s: float, direction: str
) -> None:
    got = read(resolve(f"slow_{direction}", tau_s), phi)
    share = 1.0 - math.exp(-PERIOD_S / tau_s)
    x = phi[0]
    for u, s in zip(phi, got, strict=True):
        acts = direction == "symmetric" or (u > x) == (direction == "lean_to_rich")
        x = x + (u - x) * share if acts else u
        assert s == pytest.approx(x, rel=CLOSE)


@given(phis, delays)
def test_a_dead_time_shifts_the_edges_of_its_direction_alone(phi: list[float], late: int) -> None:
    then = np.array(([phi[0]] * late + phi)[: len(phi)])
    reads = {
        "symmetric": then,
        "lean_to_rich": np.minimum(phi, then),
        "rich_to_lean": np.maximum(phi, then),
    }
    for direction, expected in reads.items():
        got = read(resolve(f"delay_{direction}", late * PERIOD_S), phi)
        np.testing.assert_allclose(got, expected, rtol=CLOSE)


@given(phis, st.floats(0.05, 0.95))
def test_a_weak_sensor_shrinks_phi_around_one(phi: list[float], gain: float) -> None:
    got = read(resolve("gain_low", gain), phi)
    np.testing.assert_allclose(got - 1.0, gain * (np.array(phi) - 1.0), atol=1e-12)


@given(phis, st.floats(0.001, 0.3))
def test_a_biased_sensor_is_off_in_lambda(phi: list[float], offset: float) -> None:
    healthy = 1.0 / np.array(phi)
    lean = faulty_readings(resolve("biased_lean", offset), healthy, PERIOD_S)
    rich = faulty_readings(resolve("biased_rich", offset), healthy, PERIOD_S)
    np.testing.assert_allclose(lean, healthy + offset, rtol=CLOSE)
    np.testing.assert_allclose(rich, healthy - offset, rtol=CLOSE, atol=CLOSE)


@given(phis, lags_s)
def test_the_transient_fault_is_slow_and_weak_together(phi: list[float], tau_s: float) -> None:
    slow = read(resolve("slow_symmetric", tau_s), phi)
    got = read(resolve("transient", tau_s), phi)
    np.testing.assert_allclose(got - 1.0, TRANSIENT_GAIN * (slow - 1.0), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "severity", "reads"),
    [
        ("stuck_lean", 0.2, 1.2),
        ("stuck_rich", 0.2, 0.8),
        ("stuck_rich", 0.9, 0.5),
        ("stuck_at_one", None, 1.0),
        ("out_of_range", None, 0.31),
        ("out_of_range", 17.0, 17.0),
    ],
)
def test_a_stuck_sensor_reads_one_value(name: str, severity: float | None, reads: float) -> None:
    got = faulty_readings(resolve(name, severity), [0.8, 1.0, 1.3], PERIOD_S)
    assert got.tolist() == [reads] * 3


@pytest.mark.parametrize("name", NAMES)
@inputs(15)
@given(st.lists(st.one_of(st.floats(0.6, 2.0), st.just(math.nan)), max_size=40))
def test_nan_stays_nan(name: str, healthy: list[float]) -> None:
    got = faulty_readings(resolve(name), healthy, PERIOD_S)
    silent = name in ("not_ready", "heater", "signal_missing")
    assert [math.isnan(value) for value in got] == [silent or math.isnan(v) for v in healthy]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reading", [0.0, -1.0, math.inf])
def test_a_reading_no_sensor_can_give_leaves_no_trace(name: str, reading: float) -> None:
    drive = [0.9, 1.1, 1.0, 0.95]
    disturbed = faulty_readings(resolve(name), [*drive[:2], reading, *drive[2:]], PERIOD_S)
    undisturbed = faulty_readings(resolve(name), drive, PERIOD_S)
    np.testing.assert_array_equal(np.delete(disturbed, 2), undisturbed)


def test_every_fault_has_a_code() -> None:
    names = {*NAMES, *FAULTS}
    assert names <= set(CODES)
    found_only = {"signal_invalid", "bus_off", "memory_lost", "balance_lean", "balance_rich"}
    assert set(CODES) - names == found_only


@pytest.mark.parametrize(
    ("name", "severity"), [*product(NAMES, [0.0, -0.5, math.nan, math.inf]), ("stuck_at_one", 3.0)]
)
def test_an_impossible_severity_is_refused(name: str, severity: float) -> None:
    with pytest.raises(UsageError, match=name):
        resolve(name, severity)


@given(phis)
def test_combined_faults_do_what_all_parts_do(phi: list[float]) -> None:
    parts = [
        resolve("slow_rich_to_lean", 0.5),
        resolve("delay_lean_to_rich", 0.4),
        resolve("biased_lean", 0.05),
    ]
    both = combined(parts)
    assert both is not None
    assert both.name == "slow_rich_to_lean+delay_lean_to_rich+biased_lean"
    # dead time, then lag, then offset, as the signal runs through the sensor
    late = faulty_readings(parts[1], 1.0 / np.array(phi), PERIOD_S)
    slow = faulty_readings(parts[0], late, PERIOD_S)
    got = faulty_readings(both, 1.0 / np.array(phi), PERIOD_S)
    np.testing.assert_allclose(got, faulty_readings(parts[2], slow, PERIOD_S), rtol=1e-9)


def test_one_or_no_part_needs_no_combining() -> None:
    part = resolve("gain_low", 0.5)
    assert combined([]) is None
    assert combined([part]) is part


@pytest.mark.parametrize(
    "names",
    [
        ("biased_lean", "biased_rich"),
        ("slow_symmetric", "transient"),
        ("delay_lean_to_rich", "delay_rich_to_lean"),
        ("stuck_lean", "stuck_rich"),
    ],
)
def test_faults_that_contradict_each_other_are_refused(names: tuple[str, str]) -> None:
    with pytest.raises(UsageError, match=names[0]):
        combined([resolve(name, s) for name, s in zip(names, (0.3, 0.7), strict=True)])


BANK = build(config.load().response)


def bank_of(phi: list[float], period_s: float = PERIOD_S) -> np.ndarray:
    return readings(config.load().response, period_s, np.array(phi))


def test_the_bank_holds_every_lag_and_dead_time_on_each_edge() -> None:
    response = config.load().response
    assert BANK[0].kind == "healthy"
    assert not BANK[0].beyond_limit
    for kind, grid, limit_s, symmetric_s in (
        ("slow", response.lags_s, response.lag_limit_s, response.lag_limit_symmetric_s),
        ("delay", response.delays_s, response.delay_limit_s, response.delay_limit_s),
    ):
        held = {(h.fault, h.seconds): h.beyond_limit for h in BANK if h.kind == kind}
        assert held == {
            (f"{kind}_{side}", s): s > (symmetric_s if side == "symmetric" else limit_s)
            for side in DIRECTIONS
            for s in grid
        }
    assert len(BANK) == 1 + 3 * (len(response.lags_s) + len(response.delays_s))


@given(phis)
def test_each_hypothesis_reads_as_the_fault_of_its_name_is_defined(phi: list[float]) -> None:
    rows = bank_of(phi)
    np.testing.assert_array_equal(rows[:, 0], phi)
    for i, h in enumerate(BANK[1:], start=1):
        expected = read(resolve(h.fault, h.seconds), phi)
        np.testing.assert_allclose(rows[:, i], expected, rtol=1e-9, err_msg=str(h))


@pytest.mark.parametrize("period_s", [0.01, 0.03, 0.25])
def test_on_other_grids_a_ramp_is_late_by_the_dead_time(period_s: float) -> None:
    # GIVEN a ramp, on which a dead time between two samples is exact
    slope = 0.05
    rows = bank_of(list(1.0 + slope * period_s * np.arange(round(6.0 / period_s))), period_s)
    for i, h in enumerate(BANK):
        if h.kind == "delay":
            acts = h.direction != "rich_to_lean"
            late = (rows[-1, 0] - rows[-1, i]) / slope
            assert late == pytest.approx(h.seconds if acts else 0.0, abs=1e-9), h
