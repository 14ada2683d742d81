"""Whole logs as arrays give what the streaming pipeline gives."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor import config
from monitor.batch.assemble import BlockAssembler
from monitor.batch.decode import BlockDecoder
from monitor.batch.blocks import block_of
from monitor.batch.samples import LogSamples, log_samples
from monitor.dtc import DtcStore
from monitor.limits import Limits
from monitor.model import Model
from monitor.own_frames import CLEARED_ID
from monitor.pipeline import FramePipeline, Tick
from monitor.replay import shipped_model
from monitor.types import Frame, FrameBlock, Sample
from tests.batch_logs import ECU, logs

MODEL = Model.load(shipped_model())
SETTINGS = config.load()
LIMITS = Limits.from_card(MODEL.card, SETTINGS, "shipped")


def blocks_of(frames: list[Frame], size: int) -> list[FrameBlock]:
    return [block_of(frames[first : first + size]) for first in range(0, len(frames), size)]


def assert_same_samples(expected: list[Sample], got: LogSamples) -> None:
    block = got.samples
    assert block.index.tolist() == [s.index for s in expected]
    assert block.t_ns.tolist() == [s.t_ns for s in expected]
    assert block.values.tobytes() == b"".join(s.values.tobytes() for s in expected)
    assert block.quality.tobytes() == b"".join(s.quality.tobytes() for s in expected)


@settings(max_examples=400, deadline=None)
@given(frames=logs(), size=st.sampled_from([1, 7, 100, 1000]))
def test_spoilt_logs_give_the_same_samples_and_counters(frames: list[Frame], size: int) -> None:
    pipeline = FramePipeline(ECU, MODEL, LIMITS, SETTINGS, DtcStore())
    expected: list[Sample] = []
    clearings = []
    for frame in frames:
        expected += [e.sample for e in pipeline.push(frame) if isinstance(e, Tick)]
        if frame.can_id == CLEARED_ID:
            clearings.append((len(expected), frame.t_ns))
    decoder = BlockDecoder(ECU, pipeline.decoder.names)
    assembler = BlockAssembler.of(decoder, MODEL.card.period_ns)
    got = log_samples(blocks_of(frames, size), decoder, assembler)
    assert_same_samples(expected, got)
    assert list(got.clearings) == clearings
    assert decoder.counters == pipeline.decoder.counters
    assert decoder.unmapped == pipeline.decoder.unmapped
    assert assembler.counters == pipeline.assembler.counters


def test_a_log_without_frames_has_no_samples() -> None:
    decoder = BlockDecoder(ECU, ECU.names)
    got = log_samples([], decoder, BlockAssembler.of(decoder, 100_000_000))
    assert got.samples.values.shape == (0, len(ECU.names))
    assert np.array_equal(got.samples.index, [])
