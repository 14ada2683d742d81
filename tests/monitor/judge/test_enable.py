"""Enable conditions, and the windows that enabled samples fill."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import Quality
from monitor.judge import enable
from monitor.judge.enable import CONDITIONS, Enable
from monitor.judge.window import Span, Window, Windows
from monitor.model.card import Channel
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model

CONFIG = config.load().enable
PERIOD_S = 0.1
NAMES = ("air_mass_mg", "lambda_controller", "lambda_measured", *enable.SIGNALS)
INPUTS = ("air_mass_mg", "lambda_controller")
RANGES = (100.0, 600.0), (0.8, 1.2)  # in training
GOOD = {
    "air_mass_mg": 300.0,
    "lambda_controller": 1.0,
    "lambda_measured": 1.0,
    "closed_loop": 1.0,
    "fuel_cut": 0.0,
    "sensor_ready": 1.0,
    "coolant_temperature_degc": 85.0,
    "engine_speed_rpm": 2000.0,
    "manifold_pressure_kpa": 50.0,
    "vehicle_speed_km_h": 60.0,
    "purge_duty_percent": 20.0,
}
# condition → a sample's value that breaks it and nothing else
BREAKS = {
    "measured_valid": ("lambda_measured", math.nan),
    "trained_range": ("air_mass_mg", 651.0),
    "closed_loop": ("closed_loop", 0.0),
    "fuel_cut_recovered": ("fuel_cut", 1.0),
    "sensor_ready": ("sensor_ready", 0.0),
    "coolant_warm": ("coolant_temperature_degc", math.nextafter(CONFIG.coolant_min_degc, 0.0)),
    "engine_speed": ("engine_speed_rpm", math.nextafter(CONFIG.engine_speed_min_rpm, 0.0)),
    "engine_load": ("manifold_pressure_kpa", math.nextafter(CONFIG.manifold_pressure_min_kpa, 0.0)),
    "vehicle_speed": ("vehicle_speed_km_h", math.nextafter(CONFIG.vehicle_speed_min_km_h, 0.0)),
    "purge_steady": ("purge_duty_percent", 0.0),
}
SIGNAL_OF = {condition: signal for condition, (signal, _) in BREAKS.items()}
# and further values that do: an engine too fast, enriched under load, a flag for a part of the tick
ALSO_BREAKS = [
    ("engine_speed", "engine_speed_rpm", math.nextafter(CONFIG.engine_speed_max_rpm, math.inf)),
    (
        "engine_load",
        "manifold_pressure_kpa",
        math.nextafter(CONFIG.manifold_pressure_max_kpa, math.inf),
    ),
    ("fuel_cut_recovered", "fuel_cut", 0.01),  # one of a hundred frames in the tick
    ("closed_loop", "closed_loop", 0.99),
    ("sensor_ready", "sensor_ready", 0.99),
]
SETTLE = 50  # samples, 5 s


def enable_of(names: tuple[str, ...], period_s: float) -> Enable:
    pairs = zip(INPUTS, RANGES, strict=True)
    inputs = [Channel(name, "-", *trained, *trained) for name, trained in pairs]
    return Enable(CONFIG, names, inputs, "lambda_measured", period_s)


class Bench:
    def __init__(self, names: tuple[str, ...] = NAMES, period_s: float = PERIOD_S) -> None:
        self.names = names
        self.subject = enable_of(names, period_s)

    def step(self, **values: float) -> dict[str, bool]:
        held = GOOD | values
        row = np.array([held[name] for name in self.names])
        (conditions,) = self.subject.push(row[np.newaxis]).tolist()
        return dict(zip(CONDITIONS, conditions, strict=True))

    def settle(self, n: int = SETTLE + 1) -> dict[str, bool]:
        for _ in range(n):
            last = self.step()
        return last


@pytest.fixture
def settled() -> Bench:
    bench = Bench()
    bench.settle()
    return bench


def blocking(conditions: dict[str, bool]) -> set[str]:
    return {name for name, holds in conditions.items() if not holds}


def test_the_model_settles_for_exactly_its_time() -> None:
    bench = Bench()
    for _ in range(SETTLE):
        assert blocking(bench.step()) == {"model_settled"}
    assert blocking(bench.step()) == set()


@pytest.mark.parametrize(("forgets_after", "wanted"), [(120, 120), (50, SETTLE), (20, SETTLE)])
def test_a_model_that_forgets_slowly_settles_for_longer(forgets_after: int, wanted: int) -> None:
    card = Model.load(shipped_model()).card
    slow = replace(card, checks={"contraction": {"samples": forgets_after}})
    names = (*card.input_names, card.output.name)
    subject = Enable.of(CONFIG, names, slow)
    middle = [0.5 * (channel.minimum + channel.maximum) for channel in (*card.inputs, card.output)]
    settled = subject.push(np.tile(middle, (200, 1)))[:, CONDITIONS.index("model_settled")]
    assert int(np.argmax(settled)) == wanted


@pytest.mark.parametrize(
    ("condition", "name", "value"), [*((c, *broken) for c, broken in BREAKS.items()), *ALSO_BREAKS]
)
def test_each_condition_blocks_on_its_own_and_is_listed(
    settled: Bench, condition: str, name: str, value: float
) -> None:
    assert blocking(settled.step(**{name: value})) == {condition}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coolant_temperature_degc", CONFIG.coolant_min_degc),
        ("engine_speed_rpm", CONFIG.engine_speed_min_rpm),
        ("engine_speed_rpm", CONFIG.engine_speed_max_rpm),
        ("manifold_pressure_kpa", CONFIG.manifold_pressure_min_kpa),
        ("manifold_pressure_kpa", CONFIG.manifold_pressure_max_kpa),
        ("vehicle_speed_km_h", CONFIG.vehicle_speed_min_km_h),
        ("purge_duty_percent", CONFIG.purge_open_percent),
        ("purge_duty_percent", GOOD["purge_duty_percent"] + CONFIG.purge_step_percent),
        ("air_mass_mg", 50.0),  # 10 % of the trained range below its lowest value
        ("air_mass_mg", 650.0),
        ("lambda_controller", 0.5),  # far out, where a biased sensor may have driven it
    ],
)
def test_a_value_on_its_limit_does_not_block(settled: Bench, name: str, value: float) -> None:
    assert blocking(settled.step(**{name: value})) == set()


@pytest.mark.parametrize("name", INPUTS)
def test_an_input_that_is_not_valid_unsettles_the_model(settled: Bench, name: str) -> None:
    assert {"inputs_valid", "model_settled"} <= blocking(settled.step(**{name: math.nan}))
    for _ in range(SETTLE):
        conditions = settled.step()
        assert conditions["inputs_valid"]
        assert not conditions["model_settled"]
    assert blocking(settled.step()) == set()


def test_a_missing_measurement_does_not_unsettle_the_model(settled: Bench) -> None:
    settled.step(lambda_measured=math.nan)
    assert blocking(settled.step()) == set()


@pytest.mark.parametrize("signal", enable.SIGNALS)
def test_a_condition_whose_signal_is_not_provided_is_listed_and_never_blocks(signal: str) -> None:
    bench = Bench(tuple(name for name in NAMES if name != signal))
    expected = {c for c, s in SIGNAL_OF.items() if s == signal} - {"measured_valid"}
    assert set(bench.subject.unavailable) == expected
    assert len(expected) == 1
    assert blocking(bench.settle()) == set()


@pytest.mark.parametrize("condition", [c for c in BREAKS if c not in ("trained_range",)])
def test_a_provided_signal_that_is_not_valid_blocks(settled: Bench, condition: str) -> None:
    assert blocking(settled.step(**{SIGNAL_OF[condition]: math.nan})) == {condition}


@pytest.mark.parametrize("period_s", [0.01, 0.1, 0.25])
@pytest.mark.parametrize(
    ("condition", "seconds", "broken"),
    [
        ("fuel_cut_recovered", CONFIG.fuel_cut_recovery_s, {"fuel_cut": 1.0}),
        ("fuel_cut_recovered", CONFIG.fuel_cut_recovery_s, {"fuel_cut": math.nan}),
        ("trained_range", CONFIG.range_recovery_s, {"air_mass_mg": 700.0}),
        ("trained_range", CONFIG.range_recovery_s, {"air_mass_mg": 40.0}),
    ],
)
def test_a_recovery_time_is_exact_in_samples_from_the_last_break(
    condition: str, seconds: float, broken: dict[str, float], period_s: float
) -> None:
    bench = Bench(period_s=period_s)
    bench.settle(CONFIG.model_settle_samples + 1)
    for part in (broken, {}, broken):
        bench.step(**part)
    # the sample that ends the recovery time is the first that may be judged again
    for _ in range(round(seconds / period_s) - 1):
        assert blocking(bench.step()) == {condition}
    assert blocking(bench.step()) == set()


@pytest.mark.parametrize(
    ("names", "cut", "blocked"),
    [
        (tuple(name for name in NAMES if name != "fuel_cut"), 0.0, {"trained_range"}),
        (NAMES, 0.0, {"trained_range"}),
        (NAMES, 1.0, {"fuel_cut_recovered"}),
    ],
)
def test_a_reading_at_the_end_of_its_range_is_judged_in_fuel_cut_only(
    names: tuple[str, ...], cut: float, blocked: set[str]
) -> None:
    bench = Bench(names)
    bench.settle()
    # WHEN the reading stands at the end of its range, with fuel, without, or nobody knows
    row = GOOD | {"fuel_cut": cut}
    values = np.array([[row[name] for name in names]])
    quality = np.zeros(values.shape, np.uint8)
    quality[0, names.index("lambda_measured")] = Quality.PINNED
    (held,) = bench.subject.push(values, quality).tolist()
    # THEN the sample is unlike those of the training, but where fuel is known to be cut
    assert blocking(dict(zip(CONDITIONS, held, strict=True))) == blocked


@pytest.mark.parametrize("period_s", [0.01, 0.1, 0.25])
@pytest.mark.parametrize(
    ("before", "after"),
    [
        (0.0, CONFIG.purge_open_percent),  # opens
        (CONFIG.purge_open_percent, 0.0),  # closes
    ],
)
def test_the_recovery_time_after_the_purge_valve_opens_or_closes_is_exact(
    before: float, after: float, period_s: float
) -> None:
    bench = Bench(period_s=period_s)
    for _ in range(CONFIG.model_settle_samples + 1):
        last = bench.step(purge_duty_percent=before)
    assert blocking(last) == set()
    for _ in range(round(CONFIG.purge_recovery_s / period_s)):
        assert blocking(bench.step(purge_duty_percent=after)) == {"purge_steady"}
    assert blocking(bench.step(purge_duty_percent=after)) == set()


def test_a_fast_change_of_purge_blocks_while_it_lasts_and_until_it_is_taken_up(
    settled: Bench,
) -> None:
    # GIVEN a valve that is open and goes far further open in one sample
    after = GOOD["purge_duty_percent"] + CONFIG.purge_step_percent + 1.0
    blocked = [blocking(settled.step(purge_duty_percent=after)) for _ in range(60)]
    # THEN the samples within a second of the change block, and the recovery time after the last
    last = round(1.0 / PERIOD_S) - 1 + round(CONFIG.purge_recovery_s / PERIOD_S)
    assert blocked == [{"purge_steady"}] * (last) + [set()] * (60 - last)


def test_a_slow_change_of_purge_that_follows_the_load_does_not_block(settled: Bench) -> None:
    per_sample = 0.9 * CONFIG.purge_step_percent * PERIOD_S
    for k in range(20):
        assert blocking(settled.step(purge_duty_percent=20.0 + k * per_sample)) == set()


def fill(
    enabled: list[bool], n_samples: int, sizes: list[int] | None = None
) -> tuple[list[Window], Windows]:
    """Return the windows of a segment whose blocks have these sizes, the last of any size."""
    subject, windows, at = Windows(n_samples), [], 0
    for size in [*(sizes or ()), len(enabled)]:
        usable = np.array(enabled[at : at + size], dtype=np.bool_)
        k = np.arange(at, at + len(usable))
        at += len(usable)
        spans = [
            Span(begin, end, np.stack([k[begin:end], -k[begin:end]], axis=1).astype(float))
            for begin, end in subject.spans(usable, goes_on=True, is_last=True)
        ]
        series = k * 100, k.astype(float), k + 0.5
        if len(usable):
            windows += [window for _, window in subject.push(spans, series, goes_on=True)]
    return windows, subject


@given(st.lists(st.booleans(), max_size=120), st.integers(1, 12), st.lists(st.integers(1, 30)))
def test_windows_are_runs_of_consecutive_enabled_samples_and_do_not_overlap(
    enabled: list[bool], n: int, sizes: list[int]
) -> None:
    windows, subject = fill(enabled, n, sizes)
    # the samples of each unbroken stretch, cut into whole windows from its start
    expected, run, discarded = [], list[int](), 0
    for k, on in enumerate([*enabled, False]):
        if on:
            run.append(k)
            if len(run) == n:
                expected.append(run)
                run = []
        else:
            discarded += bool(run) and k < len(enabled)
            run = []
    assert [w.measured.tolist() for w in windows] == expected
    assert [w.index for w in windows] == list(range(len(expected)))
    assert [(w.t_start_ns, w.t_end_ns) for w in windows] == [
        (run[0] * 100, run[-1] * 100) for run in expected
    ]
    for window in windows:
        np.testing.assert_array_equal(window.predicted, window.measured + 0.5)
        np.testing.assert_array_equal(window.residual, -0.5)
        np.testing.assert_array_equal(window.bank[:, 0], window.measured)
        np.testing.assert_array_equal(window.bank[:, 1], -window.measured)
    assert (subject.completed, subject.discarded) == (len(expected), discarded)
