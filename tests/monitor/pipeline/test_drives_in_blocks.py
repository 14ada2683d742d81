"""Simulated drives, side by side and streamed: several driving cycles, references, memories."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from monitor.base.types import Quality, SampleBlock
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.simulated_drives import WARM, sampled
from tests.helpers.logs.streamed import PERIOD_NS, SHIPPED, assert_same, fresh, stream
from training.dyno.simulation import Experiment
from training.limits.side_by_side import RecordingJudge

MODEL = Model.load(shipped_model())
LIMITS = Limits.from_card(MODEL.card, SHIPPED, "shipped")
streamed = partial(stream, model=MODEL, limits=LIMITS, settings=SHIPPED)


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
