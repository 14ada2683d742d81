"""Logs in blocks give the samples and events of the same frames on a live bus."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock, SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import LogCounters, block_of, frames_of
from monitor.frames.logs import read_blocks
from monitor.frames.loop_frames import time_mark
from monitor.grid import block_samples
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, FrameSamples
from monitor.grid.timeline import Timeline
from monitor.inject.gateway import write_log
from monitor.judge.limits import Limits
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import Model
from monitor.pipeline.collector import Collector
from monitor.pipeline.entry import bus_sources, check_long_enough, check_received
from monitor.pipeline.frames import FramePipeline
from monitor.pipeline.names import needed_names
from monitor.pipeline.replay import Setup, replay, set_up, shipped_model
from tests.helpers.drives.drive_tables import read
from tests.helpers.examples import inputs
from tests.helpers.logs.batch_logs import logs
from tests.helpers.logs.bus_maps import OWN
from tests.helpers.logs.replays import replay_log
from tests.monitor.pipeline.test_blocks import SHORT
from training.recordings.files.table_files import write_table
from training.recordings.recording import whole

MODEL = Model.load(shipped_model())
SETTINGS = config.load()
LIMITS = Limits.from_card(MODEL.card, SETTINGS, "shipped")


def blocks_of(frames: list[Frame], sizes: Sequence[int]) -> Iterator[FrameBlock]:
    left, turns = frames, cycle(sizes)
    while left:
        size = next(turns)
        yield block_of(left[:size])
        left = left[size:]


def judged(parts: Iterable[SampleBlock | Clearing], n: int) -> tuple[Any, ...]:
    block, clearings = whole(parts, n)
    return (*(column.tobytes() for column in block), clearings)


@inputs(150)
@given(
    frames=logs(),
    sizes=st.lists(st.sampled_from([1, 7, 100, 1000]), min_size=1, max_size=5),
    decoded_at_once=st.sampled_from([1, 50, 1 << 20]),
)
def test_spoilt_logs_give_one_result_however_they_are_cut_and_held(
    frames: list[Frame], sizes: list[int], decoded_at_once: int
) -> None:
    names, period_ns = needed_names(MODEL.card, OWN.names), MODEL.card.period_ns
    results = []
    for is_live, cut, held in (
        (False, [1 << 20], 1 << 20),
        (False, sizes, decoded_at_once),
        (True, sizes, 1 << 20),
    ):
        decoder = BlockDecoder(OWN, names)
        assembler = BlockAssembler.of(decoder, period_ns)
        samples = FrameSamples(decoder, assembler, is_live=is_live)
        with patch.object(block_samples, "_FRAMES", held):
            parts = [part for block in blocks_of(frames, cut) for part in samples.push(block)]
        parts.append(samples.flush())
        counters = decoder.counters, decoder.unmapped, assembler.counters
        results.append((judged(parts, len(names)), counters))
    assert results[1] == results[0]
    assert results[2] == results[0]


@inputs(50)
@given(frames=logs(), size=st.sampled_from([1, 7, 100]))
def test_a_live_sample_leaves_with_the_frame_behind_it(frames: list[Frame], size: int) -> None:
    names, period_ns = needed_names(MODEL.card, OWN.names), MODEL.card.period_ns
    decoder = BlockDecoder(OWN, names)
    assembler = BlockAssembler.of(decoder, period_ns)
    samples = FrameSamples(decoder, assembler, is_live=True)
    for block in blocks_of(frames, [size]):
        list(samples.push(block))
        assert len(samples.flush().t_ns) == 0


SETUP = set_up(None, (), SETTINGS)
# short times, so that short logs reach windows, verdicts and codes, far from what was trained
SPOILT = replace(
    SETUP,
    limits=replace(LIMITS, noise=0.02, offset_low=-0.01, offset_high=0.01),
    config=replace(SHORT, enable=replace(SHORT.enable, range_margin=5.0)),
)


def live(path: Path, setup: Setup) -> dict[str, Any]:
    """Return the entry of a recording whose frames come as on a bus."""
    log, store = LogCounters(), DtcStore()
    store.start_driving_cycle()
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
    sources = bus_sources(setup.bus_map, pipeline.monitor.names)
    collector = Collector(pipeline.monitor, sources=sources)
    timeline = Timeline(BlockDecoder(setup.bus_map, pipeline.decoder.names))
    for block in timeline.blocks(read_blocks(path, log)):
        for part in blocks_of(list(frames_of(block)), [1, 4, 160]):
            for event in pipeline.push(part):
                collector.push(event)
    check_long_enough(path, pipeline.monitor.samples)
    counters = pipeline.counters
    check_received(path, pipeline.decoder.counters, log.frames)
    counters = counters | timeline.counters.found | {"skipped": log.skipped}
    entry = collector.result(str(path), None, counters)
    notes = [*log.notes, *timeline.notes, *collector.notes]
    return entry | ({"notes": notes} if notes else {})


def replayed(path: Path, setup: Setup) -> dict[str, Any]:
    entry, _ = replay(path, setup)
    del entry["source"]
    return entry | {"sha256": None}


@inputs(100)
@given(frames=logs())
def test_a_spoilt_log_is_judged_alike_on_a_bus_and_in_a_replay(
    tmp_path_factory: pytest.TempPathFactory, frames: list[Frame]
) -> None:
    path = tmp_path_factory.mktemp("logs") / "drive.log"
    made = [*(time_mark(frame.t_ns) for frame in frames[:1]), *frames]  # as live
    assume(left := [frame for frame in made if frame.t_ns >= 0])
    write_log(path, left)
    try:
        expected = live(path, SPOILT)
    except RecordingError as error:
        with pytest.raises(RecordingError) as raised:
            replay(path, SPOILT)
        assert str(raised.value) == str(error)
        return
    assert replayed(path, SPOILT) == expected


def test_a_whole_recording_holds_only_the_signals_that_the_monitor_looks_at(tmp_path: Path) -> None:
    recorded = read(replay_log("gain_low"), SETUP)
    path = tmp_path / "table.csv"
    t_s = (recorded.block.t_ns - recorded.block.t_ns[0]) / 1e9
    values = np.column_stack([np.zeros(len(t_s)), recorded.block.values])
    write_table(path, t_s, ["wiper", *recorded.names], values)
    again = read(path, SETUP)
    assert again.names == recorded.names
    np.testing.assert_allclose(again.block.values, recorded.block.values, rtol=1e-6)
