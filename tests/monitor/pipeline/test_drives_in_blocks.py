"""Simulated drives: judged alike side by side and streamed, and by fuel cuts alone."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from monitor.base import faults
from monitor.base.types import Quality, SampleBlock
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.simulated_drives import WARM, sampled
from tests.helpers.logs.streamed import PERIOD_NS, SHIPPED, assert_same, fresh, stream
from training.dyno.simulation import Experiment
from training.limits.judging import Judged, RecordingJudge

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
