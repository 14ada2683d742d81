"""The simulated catalyst and the sensor behind it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import UsageError
from monitor.base.faults import resolve
from monitor.base.types import FloatArray
from tests.helpers.examples import inputs
from training.dyno import catalyst, downstream, ecu, tailpipe
from training.dyno.downstream import fault_behind
from training.dyno.simulation import Experiment, simulate
from training.dyno.tailpipe import emitted, limits, proposal
from training.limits.calibration_page import emissions

WARM_S = 300.0


@inputs(60)
@given(
    capacity_g=st.floats(0.005, 1.5),
    degc=st.floats(20.0, 900.0),
    air_g_s=st.floats(0.5, 120.0),
    x=st.lists(st.floats(-0.3, 1.0), min_size=1, max_size=40),
    filling=st.floats(0.0, 1.0),
)
def test_what_enters_and_does_not_leave_is_stored(
    capacity_g: float, degc: float, air_g_s: float, x: list[float], filling: float
) -> None:
    own = downstream.piece(1)._replace(capacity_g=capacity_g)
    lit, usable = catalyst.activity(degc), catalyst.usable_g(capacity_g, degc)
    cells_g = np.full(catalyst.CELLS, filling * usable / catalyst.CELLS)
    for x_in in x:
        before = cells_g.sum()
        x_out = catalyst.store(cells_g, x_in, air_g_s, 0.0025, usable, own.release_half, own, lit)
        stored = catalyst.OXYGEN_IN_AIR * air_g_s * (x_in - x_out) * 0.0025
        assert cells_g.sum() - before == pytest.approx(stored, abs=1e-12)
        # and no cell is ever over full or below empty, and the gas never changes its sign
        assert (cells_g >= 0.0).all()
        assert (cells_g <= usable / catalyst.CELLS * (1.0 + 1e-12)).all()
        assert 0.0 <= x_out * np.sign(x_in) <= abs(x_in)


@cache
def driven(fault: str = "", severity: float | None = None) -> dict[str, FloatArray]:
    """A drive of vehicle 3 with catalyst and downstream sensor."""
    found = fault_behind(fault, severity) if fault else None
    return simulate(
        Experiment(
            cycle="udds",
            vehicle=3,
            seed=2,
            duration_s=700.0,
            downstream=True,
            downstream_fault=found,
        )
    )


def after_warm_up(name: str, fault: str = "", severity: float | None = None) -> FloatArray:
    return driven(fault, severity)[name][round(WARM_S * 100) :]


def switching(volts: FloatArray) -> int:
    """How often the voltage goes from clearly rich to clearly lean."""
    state = np.where(volts > 0.6, 1, np.where(volts < 0.3, -1, 0))
    state = state[state != 0]
    return int((np.diff(state) < 0).sum())


def test_the_less_a_catalyst_stores_the_more_its_sensor_switches() -> None:
    none, low, sound = (
        switching(after_warm_up("downstream_voltage_v", "catalyst_low", g))
        for g in (0.02, 0.06, 0.6)
    )
    assert none > low > 1.2 * sound


def test_a_vehicle_without_a_downstream_sensor_sends_what_it_sent_before() -> None:
    bus_map = ecu.own_bus()
    every = [name for name in driven() if name not in bus_map.optional]
    plain = {name: driven()[name] for name in every}
    sent, behind = (
        ecu.broadcast(signals, bus_map, np.random.default_rng(1)) for signals in (plain, driven())
    )
    assert [b.outgoing.message.name for b in behind[len(sent) :]] == ["ECU_Downstream"]
    # and the frames of all other messages keep their times
    for a, b in zip(sent, behind[: len(sent)], strict=True):
        np.testing.assert_array_equal(a.times_ns, b.times_ns)


def test_in_fuel_cut_the_sensor_reads_lean_and_the_refill_brings_it_back() -> None:
    volts, cut = after_warm_up("downstream_voltage_v"), after_warm_up("fuel_cut") > 0.5
    long = np.convolve(cut, np.ones(300), "full")[: len(cut)] > 299
    assert long.any()
    assert np.median(volts[long]) < 0.15
    assert np.quantile(volts[~cut], 0.9) > 0.6


def test_the_outer_trim_holds_the_mixture_within_its_authority() -> None:
    plain = simulate(Experiment(cycle="udds", vehicle=3, seed=2, duration_s=700.0))
    closed = after_warm_up("closed_loop") > 0.5
    before = plain["lambda_target"][round(WARM_S * 100) :]
    moved = (after_warm_up("lambda_target") - before)[closed & (before < 1.035)]
    assert np.abs(np.quantile(moved, [0.05, 0.95])).max() < 0.08
    assert np.abs(moved).max() > 0.0


@pytest.mark.parametrize("kind", ["slow", "delay"])
def test_a_slow_or_late_sensor_falls_later_in_fuel_cut(kind: str) -> None:
    cut = after_warm_up("fuel_cut") > 0.5
    begins = np.flatnonzero(~cut[:-1] & cut[1:])
    fault = f"downstream_{kind}_rich_to_lean"
    sound, faulty = (after_warm_up("downstream_voltage_v", name) for name in ("", fault))
    at = begins[begins + 80 < len(cut)] + 80  # 0.8 s later
    assert np.median(faulty[at] - sound[at]) > 0.1


def test_a_weak_sensor_moves_less_and_a_stuck_one_not_at_all() -> None:
    sound = np.ptp(after_warm_up("downstream_voltage_v"))
    assert np.ptp(after_warm_up("downstream_voltage_v", "downstream_weak", 0.4)) < 0.6 * sound
    assert np.ptp(after_warm_up("downstream_voltage_v", "downstream_stuck_rich")) < 0.1


def test_an_active_test_steps_the_target_until_the_sensor_has_switched() -> None:
    signals = simulate(
        Experiment(
            cycle="wltc_3b",
            vehicle=3,
            seed=2,
            duration_s=400.0,
            downstream=True,
            active_steps_phi=0.03,
        )
    )
    target = 1.0 / signals["lambda_target"] - 1.0
    volts = signals["downstream_voltage_v"]
    rich = (target > 0.02) & (signals["closed_loop"] > 0.5) & (signals["fuel_cut"] < 0.5)
    ends = np.flatnonzero(rich[:-1] & (target[1:] < -0.015))
    assert len(ends) >= 2
    assert (volts[ends] > 0.5).mean() > 0.5


def test_a_wide_range_sensor_behind_the_catalyst_reads_lambda_and_no_voltage() -> None:
    drive = Experiment(
        cycle="udds", vehicle=3, seed=2, duration_s=400.0, downstream=True, wide_downstream=True
    )
    signals = simulate(drive)
    wide, cut = (signals[name][30000:] for name in ("downstream_lambda", "fuel_cut"))
    assert "downstream_voltage_v" not in signals
    assert np.median(np.abs(wide[cut < 0.5] - 1.0)) < 0.005
    assert wide[cut > 0.5].max() > 5.0


def test_an_impossible_fault_behind_the_sensor_is_refused() -> None:
    with pytest.raises(UsageError, match="catalyst_low"):
        fault_behind("catalyst_low", 0.0)
    with pytest.raises(UsageError, match="unknown"):
        fault_behind("catalyst_high")
    with pytest.raises(UsageError, match="below 1"):
        fault_behind("downstream_weak", 1.0)


DRIVES = [Experiment("udds", 8300, 31, duration_s=500.0, downstream=True)]


def test_a_weaker_sensor_lets_more_pass_the_catalyst() -> None:
    sound = max(emitted(DRIVES[0]))
    passed = [
        max(emitted(replace(DRIVES[0], fault=resolve("gain_low", gain)))) for gain in (0.5, 0.25)
    ]
    assert sound < passed[0] < passed[1]


def test_the_limit_lies_where_the_emissions_cross_it(monkeypatch: pytest.MonkeyPatch) -> None:
    # GIVEN emissions of drives over the severity of a weak sensor, and of a lag that costs nothing
    severities = {"gain_low": (0.9, 0.1), "slow_symmetric": (1e-3, 2e-3)}
    monkeypatch.setattr(tailpipe, "SEVERITIES", severities)
    monkeypatch.setattr(tailpipe, "STEPS", 4)
    # WHEN limits are read from them
    found = limits(1.5, DRIVES)
    # THEN one lies between the severities around the crossing, and the other is not told
    weak = found["gain_low"]
    k = int(np.flatnonzero(np.array(weak["multiples"]) > 1.5)[0])
    assert k > 0
    assert weak["severities"][k] <= weak["severity"] <= weak["severities"][k - 1]
    assert weak["of_each_car"] == [weak["severity"]]  # of the only car
    assert found["slow_symmetric"]["severity"] is None


def test_settings_follow_from_the_severest_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    at = dict.fromkeys(tailpipe.SEVERITIES, 1.0) | {"gain_low": None}
    at |= {"slow_rich_to_lean": 0.8, "slow_lean_to_rich": 0.6}
    made = {
        name: {"severity": s, "unit": "s", "of_each_car": [s], "pollutant": "NOx" * bool(s)}
        for name, s in at.items()
    }
    monkeypatch.setattr(tailpipe, "limits", lambda limit: made)
    told = proposal(1.5)
    assert told["source"] == "simulated"
    wanted = {"lag_limit_s": 0.6, "lag_limit_symmetric_s": 1.0, "delay_limit_s": 1.0}
    assert told["response"] == wanted
    rows = {
        ("gain_low", "not reached", "not reached", "-"),
        ("slow_lean_to_rich", "from 0.6 s", "0.6 s", "NOx"),
    }
    assert rows <= set(emissions(told))


def test_a_limit_below_the_healthy_emissions_is_refused() -> None:
    with pytest.raises(UsageError, match="--emission-limit 1: more than 1 is wanted"):
        proposal(1.0)
