"""The library of effects: each changes the mixture's way as its physics says, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from onnxruntime import InferenceSession

from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from tests.helpers.gap.gap_graphs import driven, plain, ranges_of
from training.cli import main
from training.greybox.chain import Constants, Path, base_path, inputs_of, simulate
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.air import following
from training.greybox.effects.model_effect import FUEL, ModelEffect
from training.greybox.graph.chain_graph import Greybox, build

BASE = Constants()


def _with(name: str, *parameters: float, **changed: FloatArray) -> tuple[Path, Path, FloatArray]:
    """Return the path without and with the effect, and the signals' fuel."""
    signals = plain_signals() | changed
    path = base_path(BASE, signals)
    return path, LIBRARY[name].apply(path, np.array(parameters), signals, PERIOD_S), path.fuel_mg


def _phi_change(name: str, *parameters: float, **changed: FloatArray) -> FloatArray:
    before, after, _ = _with(name, *parameters, **changed)
    return simulate(after, PERIOD_S) - simulate(before, PERIOD_S)


@pytest.mark.parametrize("effect", LIBRARY.values(), ids=lambda e: e.name)
def test_an_effect_of_no_size_changes_nothing(effect: Effect) -> None:
    path, after, _ = _with(effect.name, 0.0, *(p.start[0] for p in effect.parameters[1:]))
    for name in Path.__slots__:
        np.testing.assert_allclose(getattr(after, name), getattr(path, name))


@pytest.mark.parametrize("effect", LIBRARY.values(), ids=lambda e: e.name)
@pytest.mark.parametrize("bound", ["low", "high"])
def test_an_effect_stays_finite_at_its_bounds(effect: Effect, bound: str) -> None:
    values = [getattr(p, bound) for p in effect.parameters]
    assert np.isfinite(_phi_change(effect.name, *values)).all()
    assert all(p.low < start < p.high for p in effect.parameters for start in p.start)


def test_a_wall_film_leans_the_mixture_when_fuel_rises_and_keeps_the_mean() -> None:
    before, after, fuel = _with(
        "wall_film", 0.2, 0.5, 0.0, coolant_temperature_degc=np.full(6000, 88.0)
    )
    rising = np.concatenate([[0.0], np.diff(fuel)]) > 1.0
    assert (after.fuel_mg - before.fuel_mg)[rising & (fuel > 0)].mean() < -0.5
    rpm = plain_signals()["engine_speed_rpm"]
    assert after.fuel_mg @ rpm == pytest.approx(before.fuel_mg @ rpm, rel=2e-3)


def test_a_leak_and_an_air_meter_offset_matter_most_at_low_flow() -> None:
    flow = plain_signals()["maf_kg_h"]
    low, high = flow < np.quantile(flow, 0.2), flow > np.quantile(flow, 0.8)
    before, leaking, _ = _with("exhaust_leak", 0.05, 20.0, 0.5)
    drawn = 1 - leaking.factor * leaking.gas_factor / before.factor
    assert drawn[low].mean() > 3 * drawn[high].mean() > 0
    before, offset, _ = _with("maf_offset", 1.0, 2.0)
    share = 1.0 - offset.air_mg / before.air_mg
    assert share[low].mean() > 2 * share[high].mean() > 0


def test_an_ecu_that_takes_its_air_meter_at_once_takes_its_offset_at_once() -> None:
    before, offset, _ = _with("maf_offset", 0.4, 0.02)
    flow = np.maximum(plain_signals()["maf_kg_h"], 4.0)
    np.testing.assert_allclose(1.0 - offset.air_mg / before.air_mg, 0.4 / flow, atol=2e-3)


def test_how_an_ecu_follows_its_air_meter_bounds_what_the_meter_s_effects_may_be() -> None:
    meter, film = LIBRARY["maf_offset"], LIBRARY["wall_film"]
    for known_s, bounds in ((None, (0.02, 8.0)), (1.0, (0.02, 1.0)), (4.0, (0.5, 8.0))):
        followed = following(meter, known_s).parameters[1]
        assert (followed.low, followed.high) == bounds
        assert all(followed.low <= start <= followed.high for start in followed.start)
        assert following(film, known_s) is film


def test_dead_time_and_mixing_follow_the_flow() -> None:
    flow = plain_signals()["maf_kg_h"]
    before, delayed, _ = _with("delay_flow", 1.0)
    more_s = delayed.dead_time_s - before.dead_time_s
    np.testing.assert_allclose(more_s * flow, np.full(6000, 3.6 * 0.44), rtol=1e-6)
    before, mixed, _ = _with("mix_flow", 1.0)
    np.testing.assert_allclose(mixed.mixing_s - before.mixing_s, more_s)


def test_an_asymmetric_sensor_is_slower_one_way_and_faster_the_other() -> None:
    before, after, _ = _with("sensor_asymmetry", np.log(2.0))
    np.testing.assert_allclose(after.sensor_rising_s, 2.0 * before.sensor_rising_s)
    np.testing.assert_allclose(after.sensor_falling_s, 0.5 * before.sensor_falling_s)


def test_purge_enriches_while_the_valve_is_open_only() -> None:
    change = _phi_change("purge", 0.5)
    duty = plain_signals()["purge_duty_percent"]
    for_a_while = np.convolve(duty > 0, np.ones(100), "full")[:6000]
    running = plain_signals()["fuel_mass_mg"] > 0
    assert change[(for_a_while == 100) & running].mean() > 0.002
    assert np.abs(change[for_a_while == 0]).max() < 0.0002


def test_a_tail_leans_the_exhaust_after_a_fuel_cut_until_it_is_washed_out_or_over() -> None:
    signals = plain_signals()
    cut = signals["fuel_mass_mg"] <= 0
    since = np.arange(6000) - np.maximum.accumulate(np.where(cut, np.arange(6000), -1000))
    change = _phi_change("fuel_cut_tail", 0.1, 3.0, 1.0)
    late = (since > 6) & (since < 20)
    assert change[late].mean() < -0.01
    assert np.abs(change[since > 120]).max() < 1e-3
    twice = {name: 2.0 * signals[name] for name in ("air_mass_mg", "fuel_mass_mg")}
    sooner = _phi_change("fuel_cut_tail", 0.1, 3.0, 1.0, **twice)
    assert abs(sooner[late].mean()) < 0.6 * abs(change[late].mean())
    timed, same = (_phi_change("fuel_cut_tail", 0.1, 3.0, 0.0, **each) for each in ({}, twice))
    assert timed[late].mean() < -0.01
    np.testing.assert_allclose(same, timed, atol=1e-12)


def test_ethanol_scales_the_mixture_as_its_stoichiometric_ratio_does() -> None:
    before, after, _ = _with("ethanol", 0.1)
    np.testing.assert_allclose(
        after.factor / before.factor, np.full(6000, (0.9 * 14.7 + 0.9) / 14.7)
    )


def test_a_filling_runner_leans_nothing_in_the_mean_and_enriches_on_rising_charge() -> None:
    change = _phi_change("manifold_filling", 0.03)
    before, after, _ = _with("manifold_filling", 0.03)
    rising = np.concatenate([[0.0], np.diff(before.air_mg)]) > 5.0
    assert (after.air_mg - before.air_mg)[rising].max() < 0.0
    assert abs(change.mean()) < 1e-3


def test_warm_walls_scavenging_and_pulsation_act_where_their_physics_says() -> None:
    signals = plain_signals()
    before, warmed, _ = _with("charge_temperature", 0.2, 0.0, 2.0)
    hot = signals["coolant_temperature_degc"] > signals["manifold_temperature_degc"] + 5.0
    assert (warmed.air_mg < before.air_mg)[hot].all()
    _, learned, _ = _with("charge_temperature", 0.2, 0.6, 2.0)
    lost, left = (np.log(before.air_mg / path.air_mg)[hot].mean() for path in (warmed, learned))
    assert 0.3 * lost < left < 0.5 * lost
    throttled = signals["manifold_pressure_kpa"] < 0.55 * 98.0
    before, blown, _ = _with("scavenging", 0.5, 3000.0)
    np.testing.assert_array_equal(blown.air_mg[throttled], before.air_mg[throttled])
    assert (blown.air_mg > before.air_mg).any()
    before, pulsing, _ = _with("maf_pulsation", 0.5, 1500.0, 0.1, 2.0)
    assert (pulsing.air_mg <= before.air_mg).all()
    assert (pulsing.air_mg < before.air_mg).any()


def test_rail_and_injector_errors_act_on_the_fuel() -> None:
    signals = plain_signals()
    before, after, fuel = _with("rail_exponent", 0.1)
    lower = signals["rail_pressure_mpa"] < 10.0
    running = fuel > 0
    assert (after.fuel_mg < before.fuel_mg)[lower & running].all()
    assert (after.fuel_mg > before.fuel_mg)[~lower & running].all()
    before, after, fuel = _with("injector_offset", 0.2)
    np.testing.assert_allclose((after.fuel_mg - before.fuel_mg), np.where(running, 0.2, 0.0))


def test_pressure_behind_the_engine_raises_the_span_with_the_flow() -> None:
    flow = plain_signals()["maf_kg_h"]
    before, after, _ = _with("back_pressure", 1.0)
    assert np.corrcoef(after.span, flow)[0, 1] > 0.9
    assert after.span.max() > 1.1 * before.span


def test_the_command_lists_the_library(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["gap", "--library"])
    listed = capsys.readouterr().out.splitlines()
    assert {f"{e.name} ({e.tag}): {e.says}" for e in LIBRARY.values()} < set(listed)
    assert "  cold_growth 0 to 4" in listed
    assert "  needs engine_speed_rpm" in listed


CONSTANTS = Constants(
    gain=1.01, dead_time_s=0.17, dead_time_revolutions=1.6, mixing_s=0.05, sensor_s=0.12, span=0.96
)
TOLERANCE = 5e-6  # phi, of float32
over_library = pytest.mark.parametrize("effect", LIBRARY.values(), ids=LIBRARY)


def values_of(effect: Effect) -> list[list[float]]:
    """Return a start, and places well inside the bounds on both sides."""
    shares = (0.03, 0.6)
    inside = [[p.low + s * (p.high - p.low) for p in effect.parameters] for s in shares]
    return [[p.start[0] for p in effect.parameters], *inside]


def chain_with(effect: ModelEffect, reads: tuple[str, ...]) -> Greybox:
    """Return a chain with the effect, over the ranges of both drives."""
    inputs = tuple(dict.fromkeys((*inputs_of(plain().signals), *reads)))
    limits, effects = ranges_of(*inputs), (replace(effect, reads=reads),)
    return Greybox(constants=CONSTANTS, limits=limits, period_s=PERIOD_S, effects=effects)


def run(greybox: Greybox, u: FloatArray) -> FloatArray:
    """Return the free runs (batch, n) of the graph in phi, from a state of zeros."""
    session = InferenceSession(build(greybox).SerializeToString())
    state = np.zeros((len(u), greybox.state_layout.size), dtype=np.float32)
    phi = np.empty(u.shape[:2])
    for k in range(u.shape[1]):
        _, state = session.run(None, {"u": u[:, k], "state": state})
        phi[:, k] = state[:, 0]
    return phi


@over_library
def test_the_arrays_and_the_graph_of_an_effect_agree(effect: Effect) -> None:
    reads = effect.signals_of(plain().signals)
    for values in values_of(effect):
        # GIVEN a chain with the effect, and two drives in pieces, of a simulated vehicle and of
        # formulas
        added = ModelEffect.with_values(effect.name, values)
        greybox = chain_with(added, reads)
        n = greybox.memory + 600
        u = np.stack(
            [
                np.column_stack([drive.signals[name][first : first + n] for name in greybox.inputs])
                for drive in (driven(), plain())
                for first in range(0, len(drive) - n + 1, 600)
            ]
        ).astype(np.float32)
        # WHEN the graph runs over all of them side by side
        by_graph = run(greybox, u)
        # THEN it reads what the arrays read from the first sample on, and not what the plain chain
        moved = 0.0
        for phi, inputs in zip(by_graph, u.astype(np.float64), strict=True):
            by_arrays, plainly = (
                c.reading(inputs) for c in (greybox, replace(greybox, effects=()))
            )
            assert np.abs(phi - by_arrays).max() < TOLERANCE
            moved = max(moved, np.abs(by_arrays - plainly).max())
        assert moved > 1e-3


@over_library
def test_an_effect_reads_the_signals_it_says(effect: Effect) -> None:
    signals = plain_signals()
    path = base_path(CONSTANTS, signals)
    start = np.array([p.start[0] for p in effect.parameters])
    few = {name: signals[name] for name in (FUEL, *effect.signals_of(signals))}
    by_all, by_few = (effect.apply(path, start, seen, PERIOD_S) for seen in (signals, few))
    for name in Path.__slots__:
        np.testing.assert_array_equal(getattr(by_all, name), getattr(by_few, name))
