"""Recordings give the same events alone or side by side, and wherever their blocks begin."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, repeat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config, faults
from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.types import Quality, SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge import enable
from monitor.judge.limits import Limits
from monitor.memory.dtc_store import DtcStore
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.events import (
    BlockEvent,
    CutJudged,
    CycleStarted,
    DtcChanged,
    Tick,
    Ticks,
    WindowJudged,
)
from monitor.pipeline.monitor import Judge, SensorMonitor
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.simulated_drives import WARM, sampled
from tests.helpers.examples import inputs
from tests.helpers.models.networks import card_of, network_of
from training.dyno.simulation import Experiment
from training.limits.judging import Judged, RecordingJudge
from training.narx import export

PERIOD_NS = 100_000_000
SHIPPED = config.load()
# short times, so that short recordings reach windows, verdicts and codes
SHORT = replace(
    SHIPPED,
    window=replace(SHIPPED.window, n_samples=10),
    enable=replace(
        SHIPPED.enable, model_settle_samples=3, fuel_cut_recovery_s=0.3, purge_recovery_s=0.2
    ),
    cycles=replace(
        SHIPPED.cycles,
        engine_off_s=4.0,
        silent_s=1.0,
        start_s=0.5,
        denominator_run_s=6.0,
        denominator_moving_s=4.0,
        denominator_idle_s=0.5,
    ),
    plausibility=replace(
        SHIPPED.plausibility, stuck_s=1.0, start_patience_s=1.0, not_ready_s=1.0, stuck_range=0.01
    ),
    debounce=replace(SHIPPED.debounce, tick_fail_s=0.4, tick_pass_s=0.9),
    bias=replace(SHIPPED.bias, reference_windows=2),
)
INPUTS = ("air_mass_mg", "lambda_controller")
NAMES = (*INPUTS, "lambda_measured", *enable.SIGNALS)
USUAL = (300.0, 1.0, 1.0, 1.0, 0.0, 1.0, 85.0, 2000.0, 50.0, 60.0, 20.0)
TIGHT = replace(
    Limits.from_card(Model.load(shipped_model()).card, SHIPPED, "shipped"),
    j_mu=0.02,
    j_sigma=0.02,
    noise=0.02,
)


@dataclass(frozen=True)
class Streamed:
    """What one monitor makes of one recording."""

    ticks: list[Tick]
    windows: list[WindowJudged]
    cuts: list[CutJudged]
    changes: list[DtcChanged]
    cycles: list[CycleStarted]
    monitor: SensorMonitor
    reference: Reference


def stream(
    block: SampleBlock,
    names: Sequence[str],
    model: Model,
    limits: Limits,
    settings: Config,
    store: DtcStore,
    reference: Reference | None = None,
    clearings: Sequence[Clearing] = (),
    sizes: Iterable[int] = repeat(1),
) -> Streamed:
    """Judge as ``replay`` does; with a reference the vehicle learns like one with a memory.

    sizes : samples of each block, by default one as on a live bus
    """
    known = reference or Reference()
    own = limits.of_vehicle(known, settings.bias)
    monitor = SensorMonitor(Judge(names, model, settings), own, store)
    events: list[BlockEvent] = []
    k, rest = 0, iter(sizes)
    while k < len(block.t_ns):
        for each in clearings:
            if each.n_samples == k:
                events += monitor.clear(each.t_ns)
        ends = [each.n_samples for each in clearings if each.n_samples > k]
        end = min(k + next(rest, len(block.t_ns)), *ends, len(block.t_ns))
        for event in monitor.push(block.part(k, end)):
            events.append(event)
            if reference is not None and isinstance(event, CycleStarted):
                known = known if event.seen is None else known.learn(event.seen, settings.bias)
                monitor.adopt(limits.of_vehicle(known, settings.bias))
        k = end
    for each in clearings:
        if each.n_samples == len(block.t_ns):
            events += monitor.clear(each.t_ns)
    return Streamed(
        ticks=[tick for event in events if isinstance(event, Ticks) for tick in event.each()],
        windows=[event for event in events if isinstance(event, WindowJudged)],
        cuts=[event for event in events if isinstance(event, CutJudged)],
        changes=[event for event in events if isinstance(event, DtcChanged)],
        cycles=[event for event in events if isinstance(event, CycleStarted)],
        monitor=monitor,
        reference=known,
    )


def assert_same(streamed: Streamed, judged: Judged) -> None:
    assert [tick.conditions for tick in streamed.ticks] == list(
        map(tuple, judged.conditions.tolist())
    )
    assert [tick.enabled for tick in streamed.ticks] == judged.enabled.tolist()
    np.testing.assert_array_equal([tick.predicted for tick in streamed.ticks], judged.predicted)
    assert len(streamed.cuts) == len(judged.cuts)
    assert len(streamed.windows) == len(judged.windows)
    pairs = (streamed.windows, judged.windows), (streamed.cuts, judged.cuts)
    for a, b in chain.from_iterable(zip(*pair, strict=True) for pair in pairs):
        assert replace(a, window=b.window) == b  # mean, std, verdict, statistics: every digit
        for field in ("index", "t_start_ns", "t_end_ns", "measured", "predicted", "bank"):
            np.testing.assert_array_equal(getattr(a.window, field), getattr(b.window, field))
    assert streamed.changes == judged.changes
    assert streamed.cycles == judged.cycles
    assert streamed.reference == judged.reference
    assert streamed.monitor.limits == judged.limits
    assert streamed.monitor.windows.discarded == judged.interrupted_windows
    assert streamed.monitor.store.active == judged.dtcs
    assert streamed.monitor.decisions.completed == judged.completed
    assert streamed.monitor.decisions.seen == judged.seen


def fresh() -> DtcStore:
    store = DtcStore()
    store.start_driving_cycle()
    return store


def tiny_model(folder: Path, transform: str) -> Model:
    low, high = np.array([100.0, 0.8]), np.array([600.0, 1.2])
    net = network_of(INPUTS, low, high, transform, lags=3, hidden=(4,))
    path = folder / f"{transform}.onnx"
    export.write(path, export.build(net), card_of(net, low, high, longest=1.2))
    return Model.load(path)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Model]:
    folder = tmp_path_factory.mktemp("tiny")
    return {transform: tiny_model(folder, transform) for transform in ("phi", "none")}


# what may happen for a while: signals, the value they hold (None: as before), their quality
HAPPENS = {
    "an input is stale": (("air_mass_mg",), np.nan, Quality.STALE),
    "an input is not available": (("lambda_controller",), np.nan, Quality.INVALID),
    "nothing is received": (NAMES, np.nan, Quality.STALE),
    "an input leaves the trained range": (("air_mass_mg",), 900.0, Quality.GOOD),
    "lambda is stale": (("lambda_measured",), np.nan, Quality.STALE),
    "lambda is not available": (("lambda_measured",), np.nan, Quality.INVALID),
    "lambda is out of range": (("lambda_measured",), np.nan, Quality.OUT_OF_RANGE),
    "a blank in a table": (("lambda_measured", "sensor_ready"), np.nan, Quality.INVALID),
    "lambda is stuck": (("lambda_measured",), 1.1, Quality.GOOD),
    "lambda is stuck at one": (("lambda_measured",), 1.0, Quality.GOOD),
    "lambda stands in air": (("lambda_measured",), 1.3, Quality.GOOD),
    "lambda trembles by the limit of one": (("lambda_measured",), 1.03, Quality.GOOD),
    "lambda trembles by the limit of air": (("lambda_measured",), 1.2, Quality.GOOD),
    "the sensor is ready for a part of a tick": (("sensor_ready",), 0.5, Quality.GOOD),
    "the sensor is not ready": (("sensor_ready",), 0.0, Quality.GOOD),
    "the engine stands": (("engine_speed_rpm",), 0.0, Quality.GOOD),
    "fuel is cut": (("fuel_cut",), 1.0, Quality.GOOD),
    "the loop is open": (("closed_loop",), 0.0, Quality.GOOD),
    "the purge valve is closed": (("purge_duty_percent",), 0.0, Quality.GOOD),
    "the monitor is off the bus": (NAMES, np.nan, Quality.OFF_BUS),
    "the coolant is cold": (("coolant_temperature_degc",), 20.0, Quality.GOOD),
    "the vehicle stands": (("vehicle_speed_km_h",), 0.0, Quality.GOOD),
}


@st.composite
def recordings(draw: st.DrawFn) -> SampleBlock:
    """A drive in which things happen; what nothing happens to moves."""
    n = draw(st.sampled_from([0, 1, 40, 150, 260]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = np.tile(USUAL, (n, 1))
    swing = np.sin(np.cumsum(rng.normal(0.0, 0.25, (n, 2)), axis=0))
    values[:, 0] += 180.0 * swing[:, 0]
    values[:, 1] += 0.1 * swing[:, 1]
    values[:, 2] += draw(st.sampled_from([0.0, 0.1])) * swing[:, 0] + rng.normal(0.0, 0.005, n)
    quality = np.zeros(values.shape, dtype=np.uint8)
    for _ in range(draw(st.integers(0, 6))):
        signals, value, grade = HAPPENS[draw(st.sampled_from(list(HAPPENS)))]
        begin, length = draw(st.integers(0, max(n - 1, 0))), draw(st.integers(1, 80))
        for signal in signals:
            held = values[begin : begin + length, NAMES.index(signal)]
            held[:] = value
            if signal == "lambda_measured":
                held += rng.choice([0.0, 0.004]) * rng.uniform(-1.0, 1.0, len(held))
            quality[begin : begin + length, NAMES.index(signal)] = grade
    for begin in draw(st.lists(st.integers(0, max(n - 1, 0)), max_size=3)):  # ignition off, and on
        values[begin : begin + 15], quality[begin : begin + 15] = np.nan, Quality.STALE
        held = slice(begin + 15, begin + 18)
        values[held], quality[held] = USUAL, Quality.GOOD
        values[held, NAMES.index("engine_speed_rpm")] = 0.0
    index = np.arange(n)
    return SampleBlock(index, 5_000 + index * PERIOD_NS, values, quality)


def without(block: SampleBlock, missing: set[str]) -> tuple[SampleBlock, tuple[str, ...]]:
    kept = [i for i, name in enumerate(NAMES) if name not in missing]
    block = block._replace(values=block.values[:, kept], quality=block.quality[:, kept])
    return block, tuple(NAMES[i] for i in kept)


@st.composite
def cleared(draw: st.DrawFn, block: SampleBlock) -> list[Clearing]:
    at = sorted(draw(st.lists(st.integers(0, len(block.t_ns)), max_size=2)))
    return [Clearing(k, 77 + k) for k in at]


@inputs(120)
@given(
    blocks=st.lists(recordings(), max_size=5),
    missing=st.sets(st.sampled_from(enable.SIGNALS), max_size=3),
    transform=st.sampled_from(["phi", "none"]),
    rows=st.sampled_from([1, 2, 3, 64]),
    learned=st.sampled_from([None, Reference(), Reference(-0.03, -0.02, 0.96, 2)]),
    data=st.data(),
)
def test_recordings_are_judged_alike_alone_or_side_by_side_and_however_they_are_cut(
    tiny: dict[str, Model],
    blocks: list[SampleBlock],
    missing: set[str],
    transform: str,
    rows: int,
    learned: Reference | None,
    data: st.DataObject,
) -> None:
    model, names = tiny[transform], without(_EMPTY, missing)[1]
    blocks = [without(block, missing)[0] for block in blocks]
    clearings = [data.draw(cleared(block)) for block in blocks]
    stores = [fresh() for _ in blocks]
    references = None if learned is None else [learned] * len(blocks)
    judge = RecordingJudge(names, model, TIGHT, SHORT, rows)
    judged = judge.judge(blocks, stores, references, clearings)
    alone = partial(
        stream, names=names, model=model, limits=TIGHT, settings=SHORT, reference=learned
    )
    assert len(judged) == len(blocks)
    for block, got, store, own in zip(blocks, judged, stores, clearings, strict=True):
        for sizes in (repeat(1), data.draw(st.lists(st.integers(1, 120)))):
            streamed = fresh()
            found = alone(block, store=streamed, clearings=own, sizes=sizes)
            assert_same(found, got)
            assert streamed.saved == store.saved


_EMPTY = SampleBlock(
    np.arange(0), np.arange(0), np.empty((0, len(NAMES))), np.empty((0, len(NAMES)), np.uint8)
)


def test_an_infinite_input_is_refused_by_name_either_way(tiny: dict[str, Model]) -> None:
    index = np.arange(30)
    values = np.tile(USUAL, (30, 1))
    values[20, NAMES.index("lambda_controller")] = np.inf  # what the assembler never gives
    block = SampleBlock(index, index * PERIOD_NS, values, np.zeros(values.shape, dtype=np.uint8))
    with pytest.raises(ValueError, match=r"finite: lambda_controller$"):
        stream(block, NAMES, model=tiny["phi"], limits=TIGHT, settings=SHORT, store=fresh())
    with pytest.raises(ValueError, match=r"finite: lambda_controller$"):
        RecordingJudge(NAMES, tiny["phi"], TIGHT, SHORT).judge([block])


def test_an_input_of_the_model_that_is_not_there_is_named() -> None:
    with pytest.raises(RecordingError, match="rail_pressure_mpa"):
        RecordingJudge(NAMES, Model.load(shipped_model()), TIGHT, SHIPPED)


MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SHIPPED, "shipped")
streamed = partial(stream, model=MODEL, limits=LIMITS, settings=SHIPPED)


def joined(first: SampleBlock, second: SampleBlock, names: Sequence[str]) -> SampleBlock:
    """Return two drives as one recording, between which the ECU falls silent and wakes up again."""
    between = np.zeros((180, len(names)))
    quality = np.full(between.shape, int(Quality.GOOD), dtype=np.uint8)
    between[10:170], quality[10:170] = np.nan, Quality.STALE
    values = np.concatenate([first.values, between, second.values])
    quality = np.concatenate([first.quality, quality, second.quality])
    index = np.arange(1, len(values) + 1)
    return SampleBlock(index, first.t_ns[0] + index * PERIOD_NS, values, quality)


def test_every_vehicle_is_judged_by_its_own_reference_which_learns_between_two_drives() -> None:
    # GIVEN two recordings of two drives each, one of a vehicle that is known
    drives = [("hwfet", 200.0), ("us06", 200.0)]
    (first, names), (second, _) = [
        sampled(Experiment(cycle, vehicle=7, seed=9200, conditions=WARM, duration_s=duration_s))
        for cycle, duration_s in drives
    ]
    both = [joined(first, first, names), joined(first, second, names)]
    stores = [fresh() for _ in both]
    references = [Reference(), Reference(-0.03, -0.02, 0.96, 2)]
    # WHEN they are judged side by side, or one by one in a stream
    judge = RecordingJudge(names, MODEL, LIMITS, SHIPPED)
    judged = judge.judge(both, stores, references)
    # THEN each reference has learned from the first drive
    for block, reference, got, store in zip(both, references, judged, stores, strict=True):
        assert [each.seen is not None for each in got.cycles] == [True]
        assert got.reference.drives == reference.drives + 1
        assert got.limits.gain != LIMITS.gain
        assert sum(w.excited for w in got.windows) > 10
        own = fresh()
        assert_same(streamed(block, names, store=own, reference=reference), got)
        assert own.saved == store.saved
        assert store.counts.ignition_cycles == 2
    # without a reference nothing is learned, and the second drive is judged as the first one
    (alone,) = judge.judge(both[:1])
    assert alone.limits == LIMITS
    half = len(alone.windows) // 2
    assert [w.statistics for w in alone.windows[half:]] == [
        w.statistics for w in alone.windows[:half]
    ]


# Fuel cuts: the edges of lambda that a drive has without any dither tell of the sensor, too

DRIVE = Experiment("udds", vehicle=3, seed=9300, conditions=WARM, duration_s=700.0)


def judged(fault: str | None, severity: float | None, limits: Limits = LIMITS) -> Judged:
    own = faults.resolve(fault, severity) if fault else None
    block, names = sampled(replace(DRIVE, fault=own), np.random.default_rng(3))
    block.values[:, names.index("closed_loop")] = 0.0  # nothing but fuel cuts may decide
    return RecordingJudge(names, MODEL, limits, SHIPPED).judge([block])[0]


@pytest.mark.parametrize(
    ("fault", "severity"), [("slow_rich_to_lean", 0.6), ("delay_lean_to_rich", 0.5)]
)
def test_fuel_cuts_alone_name_a_slow_or_late_sensor(fault: str, severity: float) -> None:
    got = judged(fault, severity)
    assert [dtc.fault for dtc in got.dtcs if dtc.fault.startswith(("slow", "delay"))] == [fault]
    assert got.windows == []


def test_fuel_cuts_alone_call_a_sound_sensor_sound() -> None:
    got = judged(None, None)
    assert got.dtcs == []
    assert got.completed
    assert len(got.cuts) >= 10


def test_a_sensor_that_does_not_follow_fuel_cuts_is_dead_though_the_model_errs_elsewhere() -> None:
    # GIVEN a model so poor that no movement of the mixture but a fuel cut is beyond its error
    limits = replace(LIMITS, noise=0.05)
    # WHEN the sensor reads a constant and its noise, and fuel is cut
    got = judged("no_activity", 0.003, limits)
    # THEN it is called dead; a weak one is alive
    assert [dtc.fault for dtc in got.dtcs] == ["no_activity"]
    assert "no_activity" not in [dtc.fault for dtc in judged("gain_low", 0.5, limits).dtcs]
