"""The catalyst monitor on signals that are made here, apart from the simulated dynamometer."""

import math
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.second import brick as second_catalyst
from monitor.base import config
from monitor.base.files.settings import ShippedSettings
from monitor.base.types import FloatArray
from monitor.judge.catalyst.estimate import CapacityCurve
from monitor.judge.catalyst.rule import CatalystRule
from monitor.judge.catalyst.watch import NEEDED, WIDE, BehindResult, CatalystMonitor

PERIOD_S = 0.1
SETTINGS = config.shipped().catalyst
RESPONSE = config.shipped().response
NAMES = (*NEEDED, "engine_speed_rpm")


def tank_volts(
    x: FloatArray,
    air_g_s: FloatArray,
    capacity_g: float,
    lag_s: float,
    leak: float = 0.0,
    to_lean_s: float = 0.0,
) -> FloatArray:
    """Voltage behind an ideal tank: nothing passes until it is full, or empty.

    to_lean_s : lag towards lean, if another one
    """
    held, richness, volts = 0.5 * capacity_g, 0.5, []
    for each, air in zip(x.tolist(), air_g_s.tolist(), strict=True):
        held += 0.23 * air * each * PERIOD_S
        resting = 0.85 - 0.4 * held / capacity_g  # the fuller, the leaner the gas above the store
        now = 0.0 if held > capacity_g else 1.0 if held < 0.0 else resting
        if leak * np.exp(-air / 8.0) > 0.003 and held >= 0.0:
            now = 0.0
        held = min(max(held, 0.0), capacity_g)
        own_s = to_lean_s if to_lean_s and now < richness else lag_s
        richness += (now - richness) * (1.0 - np.exp(-PERIOD_S / own_s))
        volts.append(0.07 + 0.72 * richness)
    return np.array(volts)


def a_drive(
    capacity_g: float,
    lag_s: float = 0.1,
    minutes: float = 7.0,
    seed: int = 1,
    offset: float = 0.0,
    leak: float = 0.0,
    unseen_fuel: float = 0.0,
    to_lean_s: float = 0.0,
) -> FloatArray:
    """Modulated driving with changing load and a fuel cut each 40 s, (n, n_names).

    offset : of the upstream sensor's lambda; leak : of air behind the catalyst, at no flow
    """
    rng = np.random.default_rng(seed)
    n = round(minutes * 60 / PERIOD_S)
    t_s = PERIOD_S * np.arange(n)
    air_g_s = 12.0 + 8.0 * np.sin(t_s / 9.0) + 3.0 * np.sin(t_s / 2.3)
    x = 0.03 * np.sign(np.sin(2.0 * np.pi * t_s / 2.4)) + 0.004 * rng.standard_normal(n)
    cut = t_s % 40.0 < 4.0
    refill = (t_s % 40.0 >= 4.0) & (t_s % 40.0 < 8.0)
    air_g_s[cut] = 4.0
    x = np.where(cut, 0.93, np.where(refill, -0.06, x))
    gas = np.where(refill, x - unseen_fuel, x)
    volts = tank_volts(gas, air_g_s, capacity_g, lag_s, leak, to_lean_s)
    volts += 0.01 * rng.standard_normal(n)
    measured = 1.0 / (1.0 - x) + offset
    return np.column_stack([volts, measured, 3.6 * air_g_s, np.full(n, 2000.0)])


def wide_lambda(x: FloatArray, air_g_s: FloatArray, capacity_g: float, lag_s: float) -> FloatArray:
    """Lambda of a wide-range sensor behind an ideal tank, 0.002 too lean."""
    held, read, seen = 0.5 * capacity_g, 0.0, []
    for each, air in zip(x.tolist(), air_g_s.tolist(), strict=True):
        held += 0.23 * air * each * PERIOD_S
        passes = each if not 0.0 <= held <= capacity_g else 0.002 * held / capacity_g - 0.001
        held = min(max(held, 0.0), capacity_g)
        read += (passes - read) * (1.0 - np.exp(-PERIOD_S / lag_s))
        seen.append(read + 0.002)
    return np.asarray(1.0 / (1.0 - np.array(seen)))


def judged(
    values: FloatArray, block: int = 700, names: tuple[str, ...] = NAMES
) -> tuple[CatalystMonitor, list[BehindResult]]:
    monitor = CatalystMonitor(config.shipped(), names, PERIOD_S)
    results = []
    for first in range(0, len(values), block):
        own = values[first : first + block]
        part = monitor.push(own, np.ones(len(own), dtype=np.bool_))
        results += [each._replace(at=each.at + first) for each in part]
    return monitor, results


def entry_of(values: FloatArray, names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    entry = judged(values, names=names)[0].entry()
    assert entry is not None
    return entry


@pytest.mark.parametrize("capacity_g", [0.03, 0.06, 0.3, 0.6])
def test_a_catalyst_is_judged_by_what_it_stores(capacity_g: float) -> None:
    entry = entry_of(a_drive(capacity_g))
    assert entry["verdict"] == ("failed" if capacity_g < 0.1 else "passed")
    assert entry["sensor_verdict"] != "failed"
    if capacity_g > 0.1:
        assert entry["capacity_g"] == pytest.approx(capacity_g, rel=0.5)


@pytest.mark.parametrize(
    ("capacity_g", "lag_s"), [(0.05, 0.1), (0.3, 0.1), (0.05, 1.5), (0.3, 1.5)]
)
def test_a_wide_range_sensor_behind_tells_what_it_stores(capacity_g: float, lag_s: float) -> None:
    values = a_drive(capacity_g)
    air_g_s = values[:, 2] / 3.6
    values[:, 0] = wide_lambda(1.0 - 1.0 / values[:, 1], air_g_s, capacity_g, lag_s)
    monitor, results = judged(values, names=(WIDE, *NAMES[1:]))
    entry = monitor.entry()
    assert entry is not None
    assert entry["verdict"] == ("failed" if capacity_g < 0.1 else "passed")
    # THEN a sound sensor is never called, and a slow one never passes
    assert entry["sensor_verdict"] != ("passed" if lag_s > 1.0 else "failed")
    # and its circuit is left to other tests
    assert {r.test for r in results} <= {"catalyst", "downstream", "balance", "bias"}
    assert "downstream_circuit" not in monitor.supported


@pytest.mark.parametrize(("to_rich_s", "to_lean_s"), [(0.1, 0.45), (0.45, 0.1)])
def test_a_sensor_that_is_slower_in_one_direction_within_the_spread_is_sound(
    to_rich_s: float, to_lean_s: float
) -> None:
    entry = entry_of(a_drive(0.25, to_rich_s, to_lean_s=to_lean_s))
    assert (entry["verdict"], entry["sensor_verdict"]) == ("passed", "passed")


@pytest.mark.parametrize(
    ("volts", "fault"), [(0.3, "downstream_stuck_lean"), (0.8, "downstream_stuck_rich")]
)
def test_a_voltage_that_no_gas_moves_is_stuck_on_its_side_and_passes_nothing(
    volts: float, fault: str
) -> None:
    values = a_drive(0.3)
    values[:, 0] = volts + 0.01 * np.random.default_rng(1).standard_normal(len(values))
    _, results = judged(values)
    # THEN only the sensor is called, and its circuit alone passes
    assert {r.claim.fault for r in results if r.claim.outcome == "failed"} == {fault}
    assert {r.test for r in results if r.claim.outcome == "passed"} == {"downstream_circuit"}


@pytest.mark.parametrize(
    ("offset", "faults"),
    [
        (0.0, set()),
        (0.022, {"balance_rich", "biased_lean"}),
        (-0.022, {"balance_lean", "biased_rich"}),
    ],
)
def test_an_upstream_offset_contradicts_the_balance(offset: float, faults: set[str]) -> None:
    monitor, results = judged(a_drive(0.3, offset=offset))
    entry = monitor.entry()
    assert entry is not None
    found = {r.claim.fault for r in results[-4:] if r.claim.outcome == "failed"}
    assert found == faults
    assert entry["verdict"] != "failed"
    if faults:
        assert entry["upstream_offset_lambda"] == pytest.approx(offset, abs=0.008)


@pytest.mark.parametrize(
    ("offset", "outcome"),
    [(0.005, "passed"), (0.01, "inconclusive"), (0.013, "inconclusive"), (0.016, "failed")],
)
def test_an_offset_between_sound_and_biased_is_neither(offset: float, outcome: str) -> None:
    rule = CatalystRule(config.shipped(), PERIOD_S)
    rule._evidence[:, :, np.array(SETTINGS.offsets_phi) != offset] = -30.0
    rule._evidence[rule._has_leak] = -30.0
    rule.segments = 1
    assert rule.balance().outcome == outcome


def test_sound_sensors_are_likelier_before_any_evidence() -> None:
    rule = CatalystRule(config.shipped(), PERIOD_S)
    assert rule.balance().log_odds < -1.0
    assert rule.sensor().log_odds < -3.0


@pytest.mark.parametrize(
    ("late_s", "gain", "fault"), [(1.5, 1.0, "downstream_delay"), (0.0, 0.4, "downstream_weak")]
)
def test_a_late_or_weak_downstream_sensor_is_named(late_s: float, gain: float, fault: str) -> None:
    values, late = a_drive(0.06), round(late_s / PERIOD_S)
    values[late:, 0] = 0.45 + gain * (values[: len(values) - late, 0] - 0.45)
    _, results = judged(values)
    last = [r.claim for r in results if r.test == "downstream"][-1]
    assert (last.fault or "").startswith(fault)


def test_a_voltage_that_never_leaves_its_rest_is_no_evidence() -> None:
    values = np.column_stack([a_drive(0.3, minutes=2.0), np.full(1200, 600.0)])
    values[:, 0] = 0.45
    assert entry_of(values, (*NAMES, "catalyst_temperature_degc"))["segments"] == 0


def test_the_offset_has_a_standard_error_from_the_spread_of_the_drive() -> None:
    stds, errors = [], []
    for seed in range(3):
        entry = entry_of(a_drive(0.3, offset=0.005, seed=seed, minutes=5.0))
        errors.append(entry["upstream_offset_lambda"] - 0.005)
        stds.append(entry["upstream_offset_std"])
    assert min(stds) >= SETTINGS.offset_model_phi
    assert np.abs(errors).max() < 3.0 * max(stds)


SLOW = "downstream_slow_lean_to_rich"


def spoken(rule: CatalystRule, fault: str, lead: float) -> float:
    """Let a segment speak for the sensors with a fault; return the log odds of a faulty one."""
    rule._least, rule._most = 0.1, 0.8
    is_own = np.array(rule._faults) == fault
    rule._segment[:] = np.where(is_own, 0.0, -lead / rule._weight)[:, np.newaxis, np.newaxis]
    rule._close()
    return rule.sensor().log_odds


def test_no_segment_decides_alone() -> None:
    rule = CatalystRule(config.shipped(), PERIOD_S)
    assert spoken(rule, SLOW, 1e6) < SETTINGS.segment_most


@pytest.mark.parametrize(
    ("fault", "low_v", "high_v", "may_be"),
    [
        ("downstream_stuck_rich", 0.7, 0.78, True),
        ("downstream_stuck_rich", 0.7, 0.95, False),
        ("downstream_weak", 0.3, 0.6, True),
        ("downstream_weak", 0.1, 0.8, False),
    ],
)
def test_a_sensor_that_moved_is_not_stuck_nor_weak_between_lean_and_rich(
    fault: str, low_v: float, high_v: float, may_be: bool
) -> None:
    rule = CatalystRule(config.shipped(), PERIOD_S)
    rule.low_v, rule.high_v = low_v, high_v
    for _ in range(10):
        spoken(rule, fault, SETTINGS.segment_most)
    assert (rule.sensor().fault == fault) is may_be


def test_a_sensor_that_fails_after_hours_shows_within_five_minutes() -> None:
    rule = CatalystRule(config.shipped(), PERIOD_S)
    for _ in range(300):
        spoken(rule, "", SETTINGS.segment_most)
    after = [spoken(rule, SLOW, SETTINGS.segment_most) for _ in range(60)]
    assert after[0] < 0.0 < RESPONSE.evidence_fail < after[-1]


@pytest.mark.parametrize(
    ("segments", "fades"), [(SETTINGS.evidence_segments, True), (10_000, False)]
)
def test_a_longer_drive_makes_no_error_of_the_model_certain(segments: int, fades: bool) -> None:
    # GIVEN segments that all speak a little for the same wrong sensor
    own = replace(SETTINGS, evidence_segments=segments)
    rule = CatalystRule(replace(config.shipped(), catalyst=own), PERIOD_S)
    odds = [spoken(rule, SLOW, 0.05) for _ in range(8 * 60)]
    # THEN the claim stays open however long the drive is, unless nothing fades
    assert (max(odds) < RESPONSE.evidence_fail) is fades
    assert odds[-1] > odds[0]


def test_nothing_is_judged_while_the_engine_stands_with_the_ignition_on() -> None:
    # GIVEN a sound catalyst, judged on a drive
    before, _ = judged(a_drive(0.3, minutes=4.5))
    for volts, upstream in ((0.45, 16.0), (0.45, 1.0), (0.0, math.nan)):
        # WHEN the engine stands for six minutes, in which the sensors cool down
        monitor = deepcopy(before)
        rest = np.tile([volts, upstream, 0.0, 0.0], (round(360.0 / PERIOD_S), 1))
        # THEN nothing is added to what was found
        assert not list(monitor.push(rest, np.zeros(len(rest), dtype=np.bool_)))
        assert monitor.entry() == before.entry()


@pytest.mark.parametrize(
    ("key", "end"), [("threshold_g", "min"), ("threshold_g", "max"), ("offset_biased_phi", "max")]
)
def test_a_limit_leaves_members_of_the_bank_on_either_side(
    key: str, end: str, tmp_path: Path
) -> None:
    # GIVEN the largest or least limit that settings may have
    bounds = ShippedSettings("monitor.base").sections["catalyst"]
    edges = {"threshold_margin": bounds["threshold_margin"].max, key: getattr(bounds[key], end)}
    given = tmp_path / "own.toml"
    given.write_text("[catalyst]\n" + "".join(f"{k} = {v}\n" for k, v in edges.items()))
    rule = CatalystRule(config.load(given), PERIOD_S)
    # WHEN a segment is full THEN catalyst and balance are judged
    while not rule.push(0.01, 10.0, 0.5, counts=True):
        pass
    assert math.isfinite(rule.catalyst().log_odds)
    assert math.isfinite(rule.balance().log_odds)


@pytest.mark.parametrize(
    "error",
    [{"lag_s": 1.5}, {"lag_s": 3.0}, {"offset": 0.02}, {"offset": -0.02}],
    ids=["slow", "very slow", "upstream reads lean", "upstream reads rich"],
)
def test_no_error_of_a_sensor_passes_a_bad_catalyst(error: dict[str, float]) -> None:
    assert entry_of(a_drive(0.05, **error))["verdict"] != "passed"


@pytest.mark.parametrize("capacity_g", [0.05, 0.4])
def test_fuel_in_the_refill_that_the_front_sensor_does_not_see_turns_no_verdict(
    capacity_g: float,
) -> None:
    # GIVEN wall film that makes the gas richer by 0.03 after each fuel cut than the sensor reads
    entry = entry_of(a_drive(capacity_g, unseen_fuel=0.03))
    assert entry["verdict"] != ("passed" if capacity_g < 0.1 else "failed")
    assert entry["sensor_verdict"] != "failed"


@pytest.mark.parametrize(("capacity_g", "verdict"), [(0.05, "failed"), (0.4, "passed")])
def test_a_catalyst_of_other_equations_with_slow_reactions_is_judged_rightly(
    capacity_g: float, verdict: str
) -> None:
    # GIVEN a plug of gas with rates of reaction, of which much passes at high flow
    own = second_catalyst.brick(1, capacity_g)
    values = second_catalyst.drive(1, 1, own)
    entry = entry_of(values, second_catalyst.NAMES)
    assert entry["verdict"] == verdict
    assert entry["sensor_verdict"] != "failed"
    assert entry["balance_verdict"] != "failed"


def test_a_leak_behind_the_catalyst_is_no_fault_of_a_sensor_or_the_catalyst() -> None:
    monitor, results = judged(a_drive(0.3, leak=0.02))
    found = {r.claim.fault for r in results if r.claim.outcome == "failed"}
    assert found == {"balance_lean"}
    entry = monitor.entry()
    assert entry is not None
    assert entry["sensor_verdict"] == "passed"


def test_no_result_depends_on_where_blocks_begin() -> None:
    values = a_drive(0.06, minutes=6.0)
    values[2000:2030, 0] = np.nan  # bridged no longer
    values[2500:2505, 1] = np.nan  # bridged
    whole, small = judged(values, 5000), judged(values, 7)
    told = [[(r.at, r.test, r.claim) for r in results] for _, results in (whole, small)]
    assert told[0] == told[1]


def test_a_stretch_without_values_loses_the_filling_once(monkeypatch: pytest.MonkeyPatch) -> None:
    values, lost = a_drive(0.06, minutes=2.0), list[CatalystRule]()
    values[300:900, 1] = np.nan
    monitor, _ = judged(values[:300])
    monkeypatch.setattr(CatalystRule, "interrupt", lambda rule: lost.extend([rule]))
    list(monitor.push(values[300:], np.ones(900, dtype=np.bool_)))
    assert lost == [monitor.rule]


def test_without_the_voltage_there_is_nothing_to_judge() -> None:
    values = a_drive(0.06, minutes=1.0)
    values[:, 0] = np.nan
    monitor, results = judged(values)
    assert (results, monitor.entry()) == ([], None)


def test_a_cold_brick_is_not_judged() -> None:
    names = (*NAMES, "catalyst_temperature_degc")
    values = np.column_stack([a_drive(0.02), np.full(4200, 250.0)])
    assert {r.test for r in judged(values, names=names)[1]} == {"downstream_circuit"}
    assert entry_of(values, names)["segments"] == 0


LOG_G = np.log(np.array(config.shipped().catalyst.capacities_g))
PARTS = 8


def evidence(grams: float, width: float) -> FloatArray:
    """Log likelihood at the bank's capacities of a drive that tells ``grams`` within ``width``."""
    return np.asarray(-0.5 * ((LOG_G - np.log(grams)) / width) ** 2)


@pytest.mark.parametrize("grams", [0.052, 0.1, 0.3, 0.32, 0.44, 0.6])
def test_a_capacity_between_two_of_the_bank_is_estimated_where_it_is(grams: float) -> None:
    # GIVEN evidence that is narrower than the steps of the bank
    own = evidence(grams, 0.06)
    found = CapacityCurve(LOG_G).estimate(own, np.tile(own, (PARTS, 1)), shared=0.0)
    assert found.grams == pytest.approx(grams, rel=0.03)
    assert found.low_g < grams < found.high_g
    assert found.high_g / found.low_g == pytest.approx(np.exp(2 * 1.645 * 0.06), rel=0.1)


def test_stretches_that_disagree_widen_the_interval() -> None:
    curve, own = CapacityCurve(LOG_G), evidence(0.3, 0.06)
    alike = np.tile(own, (PARTS, 1))
    apart = np.array([evidence(0.3 * np.exp(0.03 * (-1) ** i), 0.06) for i in range(PARTS)])
    widths = [
        np.log(f.high_g / f.low_g) for f in (curve.estimate(own, w, 0.0) for w in (alike, apart))
    ]
    spread = np.sqrt((PARTS - 1) * 0.03**2)  # of the jackknife
    assert widths[1] == pytest.approx(np.hypot(widths[0], 2 * 1.645 * spread), rel=0.05)


def test_evidence_without_an_upper_end_is_a_bound() -> None:
    own = np.where(np.log(0.6) > LOG_G, -50.0, 0.0)
    found = CapacityCurve(LOG_G).estimate(own, np.tile(own, (PARTS, 1)), shared=0.05)
    assert found.is_bound
    assert 0.4 < found.low_g < 0.8
