"""Simulated drives, side by side and streamed: several driving cycles, references, memories."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from monitor.base import faults
from monitor.base.types import Quality, SampleBlock
from monitor.judge.limits import Limits
from monitor.memory.codes import TESTS
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from monitor.pipeline.side_by_side import judge_all
from tests.helpers.logs.streamed import PERIOD_NS, SHIPPED, assert_same, fresh, kept, stream
from training.dyno import ecu, vehicle
from training.dyno.simulation import Experiment, simulate

MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SHIPPED, "shipped")
streamed = partial(stream, model=MODEL, limits=LIMITS, settings=SHIPPED)
WARM = vehicle.conditions(1)._replace(coolant_start_degc=85.0)


def simulated(experiment: Experiment) -> tuple[SampleBlock, tuple[str, ...]]:
    bus_map = ecu.own_bus()
    rng = np.random.default_rng([experiment.seed, experiment.vehicle])
    sent = ecu.broadcast(
        simulate(experiment), bus_map, rng, experiment.fault, experiment.fault_start_s
    )
    return ecu.samples(sent, bus_map, PERIOD_NS), bus_map.names


@pytest.fixture(scope="module")
def drives() -> tuple[list[SampleBlock], tuple[str, ...]]:
    """Three healthy drives of different lengths and some with a fault in the loop."""
    found = [
        simulated(Experiment(cycle, vehicle=7 + k, seed=9200 + k, conditions=WARM, duration_s=s))
        for k, (cycle, s) in enumerate((("hwfet", 300.0), ("udds", 400.0), ("us06", 300.0)))
    ]
    for k, name in enumerate(("slow_symmetric", "stuck_lean", "signal_missing", "out_of_range")):
        fault = faults.resolve(name)
        begin_s = 60.0 if fault.missing else 0.0
        drive = Experiment("hwfet", seed=9210 + k, conditions=WARM, fault=fault, duration_s=240.0)
        found.append(simulated(replace(drive, fault_start_s=begin_s)))
    return [block for block, _ in found], found[0][1]


def test_simulated_drives_with_the_shipped_model_are_judged_alike(
    drives: tuple[list[SampleBlock], tuple[str, ...]],
) -> None:
    blocks, names = drives
    judged = judge_all(blocks, names, MODEL, LIMITS, SHIPPED)
    for block, got in zip(blocks, judged, strict=True):
        assert_same(streamed(block, names, limits=LIMITS, store=fresh()), got)
    # there was something to compare
    assert sum(len(j.windows) for j in judged) > 60
    assert sum(len(j.cuts) for j in judged) > 8
    assert any(w.excited for j in judged for w in j.windows)
    assert {"out_of_range", "signal_missing"} <= {d.fault for j in judged for d in j.dtcs}
    assert any(j.completed for j in judged)


def test_every_vehicle_is_judged_by_its_own_reference(
    drives: tuple[list[SampleBlock], tuple[str, ...]],
) -> None:
    blocks, names = drives
    references = [Reference(), Reference(-0.03, -0.02, 0.96, 2), Reference(0.2, 0.2, 1.0, 1)]
    judged = judge_all(blocks[:3], names, MODEL, LIMITS, SHIPPED, references=references, rows=2)
    for block, reference, got in zip(blocks[:3], references, judged, strict=True):
        assert_same(streamed(block, names, store=fresh(), reference=reference), got)
    # a reference that is far off makes the healthy sensor look biased
    assert {w.fault for w in judged[2].windows} & set(TESTS["bias"])


def ignition_off_and_on(names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return values and quality of an ECU that falls silent after the engine and wakes up again."""
    values = np.zeros((180, len(names)))
    quality = np.full(values.shape, int(Quality.GOOD), dtype=np.uint8)
    values[10:170], quality[10:170] = np.nan, Quality.STALE
    return values, quality


def joined(first: SampleBlock, second: SampleBlock, names: Sequence[str]) -> SampleBlock:
    """Return two drives as one recording."""
    values, quality = ignition_off_and_on(names)
    values = np.concatenate([first.values, values, second.values])
    index = np.arange(1, len(values) + 1)
    return SampleBlock(
        index,
        first.t_ns[0] + index * PERIOD_NS,
        values,
        np.concatenate([first.quality, quality, second.quality]),
    )


def test_the_reference_learns_between_two_drives_of_one_recording(
    drives: tuple[list[SampleBlock], tuple[str, ...]],
) -> None:
    blocks, names = drives
    both = [joined(blocks[0], blocks[0], names), joined(blocks[0], blocks[2], names)]
    stores = [fresh() for _ in both]
    references = [Reference()] * len(both)
    judged = judge_all(both, names, MODEL, LIMITS, SHIPPED, stores=stores, references=references)
    for block, got, store in zip(both, judged, stores, strict=True):
        assert [each.seen is not None for each in got.cycles] == [True]
        assert got.reference.drives == 1
        assert got.limits.gain != LIMITS.gain
        own = fresh()
        assert_same(streamed(block, names, store=own, reference=Reference()), got)
        assert kept(own) == kept(store)
        assert store.counts.ignition_cycles == 2
    # without a reference nothing is learned, and the second drive is judged as the first one
    (alone,) = judge_all(both[:1], names, MODEL, LIMITS, SHIPPED)
    assert alone.limits == LIMITS
    half = len(alone.windows) // 2
    assert [w.statistics for w in alone.windows[half:]] == [
        w.statistics for w in alone.windows[:half]
    ]
