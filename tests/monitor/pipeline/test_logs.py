"""Logs in blocks give the samples and events of the same frames on a live bus."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import Frame, FrameBlock, SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.frames.blocks import block_of
from monitor.grid import block_samples
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, FrameSamples
from monitor.model.step import Model
from monitor.pipeline.names import needed_names
from monitor.pipeline.replay import set_up, shipped_model
from tests.helpers.drives.drive_tables import read
from tests.helpers.examples import inputs
from tests.helpers.logs.batch_logs import logs
from tests.helpers.logs.bus_maps import OWN
from tests.helpers.logs.replays import replay_log
from training.recordings.files.table_files import write_table
from training.recordings.recording import whole

MODEL = Model.load(shipped_model())
SETTINGS = config.load()


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


def test_a_whole_recording_holds_only_the_signals_that_the_monitor_looks_at(tmp_path: Path) -> None:
    recorded = read(replay_log("gain_low"), SETUP)
    path = tmp_path / "table.csv"
    t_s = (recorded.block.t_ns - recorded.block.t_ns[0]) / 1e9
    values = np.column_stack([np.zeros(len(t_s)), recorded.block.values])
    write_table(path, t_s, ["wiper", *recorded.names], values)
    again = read(path, SETUP)
    assert again.names == recorded.names
    np.testing.assert_allclose(again.block.values, recorded.block.values, rtol=1e-6)
