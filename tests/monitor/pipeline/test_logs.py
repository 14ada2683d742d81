"""Whole logs as arrays give what the streaming pipeline gives."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.types import Frame, FrameBlock, Sample
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.frames.blocks import block_of
from monitor.frames.loop_frames import CLEARED_ID
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import LogSamples, log_samples
from monitor.judge.limits import Limits
from monitor.memory.dtc import DtcStore
from monitor.model.step import Model
from monitor.pipeline.events import Tick
from monitor.pipeline.frames import FramePipeline
from monitor.pipeline.recordings import JudgedRecording, RecordingReader, judge_logs
from monitor.report.replay import Setup, replay, set_up, shipped_model
from tests.helpers.batch_logs import ECU, S, logs
from training.recordings.table_files import write_table

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


@settings(max_examples=150, deadline=None)
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


# From files to verdicts

ROOT = Path(__file__).resolve().parents[3]
SETUP = set_up(None, (), SETTINGS)
# short times, so that short logs reach windows, verdicts and codes
SHORT = replace(
    SETUP,
    limits=replace(LIMITS, noise=0.02, excitation=0.0, offset_low=-0.01, offset_high=0.01),
    config=replace(
        SETTINGS,
        window=replace(SETTINGS.window, n_samples=8),
        enable=replace(
            SETTINGS.enable,
            model_settle_samples=2,
            fuel_cut_recovery_s=0.2,
            purge_recovery_s=0.1,
            range_margin=5.0,
        ),
        plausibility=replace(
            SETTINGS.plausibility, stuck_s=0.5, start_patience_s=1.0, not_ready_s=1.0
        ),
        debounce=replace(SETTINGS.debounce, tick_fail_s=0.4, tick_pass_s=0.9),
        cycles=replace(SETTINGS.cycles, engine_off_s=5.0, silent_s=2.0, start_s=0.5),
    ),
)


def _given(setup: Setup) -> tuple[BusMap, Model, Limits, Config]:
    return setup.bus_map, setup.model, setup.limits, setup.config


def judged(paths: list[Path], setup: Setup, side_by_side: int = 64) -> list[JudgedRecording]:
    return list(judge_logs(paths, *_given(setup), columns=setup.columns, side_by_side=side_by_side))


def replayed(path: Path, setup: Setup) -> dict[str, Any]:
    entry, _ = replay(path, setup)
    del entry["source"]
    return entry | {"sha256": None}


def write(path: Path, frames: list[Frame]) -> None:
    lines = [
        f"({f.t_ns // S}.{f.t_ns % S // 1000:06d}) can0 "
        f"{f.can_id:{'08X' if f.is_extended else '03X'}}#{f.data.hex()}\n"
        for f in frames
        if f.t_ns >= 0
    ]
    path.write_text("".join(lines))


def test_the_recorded_drives_are_judged_as_o2mon_replay_judges_them() -> None:
    paths = sorted((ROOT / "replay_logs").glob("*.blf"))
    found = judged(paths, SETUP, side_by_side=12)
    assert [each.path for each in found] == paths
    for each in found:
        assert each.entry == replayed(each.path, SETUP)
    assert sum(each.entry is not None and each.entry["fault_flag"] for each in found) > 10


@settings(max_examples=150, deadline=None)
@given(drives=st.lists(logs(), min_size=1, max_size=4))
def test_spoilt_logs_are_judged_as_o2mon_replay_judges_them(
    tmp_path_factory: pytest.TempPathFactory, drives: list[list[Frame]]
) -> None:
    folder = tmp_path_factory.mktemp("logs")
    paths = [folder / f"{number}.log" for number in range(len(drives))]
    for path, frames in zip(paths, drives, strict=True):
        write(path, frames)
    for path, got in zip(paths, judged(paths, SHORT, side_by_side=3), strict=True):
        try:
            expected = replayed(path, SHORT)
        except RecordingError as error:
            assert str(got.error) == str(error)
            assert got.entry is None
            continue
        assert got.entry == expected
        assert got.error is None


def test_a_recording_that_cannot_be_used_is_its_reason_and_the_others_go_on(
    tmp_path: Path,
) -> None:
    (good,) = (ROOT / "replay_logs").glob("stuck_lean_*.blf")
    cut, strange = tmp_path / "cut.blf", tmp_path / "drive.xyz"
    cut.write_bytes(good.read_bytes()[:-100])
    strange.write_text("?")
    gone = tmp_path / "gone.log"
    table = tmp_path / "table.csv"
    table.write_text("time_s,lambda_measured\n0.0,1.0\n0.1,1.0\n")
    paths = [cut, good, strange, gone, table, good]
    found = judged(paths, SETUP, side_by_side=4)
    assert [each.error is None for each in found] == [False, True, False, False, False, True]
    for each in found:
        if each.error is not None and each.path != gone:
            with pytest.raises(RecordingError) as raised:
                replay(each.path, SETUP)
            assert str(each.error) == str(raised.value)
    assert "cannot read it: No such file" in str(found[3].error)
    assert found[1].entry == found[5].entry == replayed(good, SETUP)


def test_recordings_are_read_only_as_many_at_a_time_as_are_judged_side_by_side() -> None:
    (log,) = (ROOT / "replay_logs").glob("stuck_rich_*.blf")
    asked: list[Path] = []

    def paths() -> Iterator[Path]:
        for _ in range(7):
            asked.append(log)
            yield log

    found = judge_logs(paths(), *_given(SETUP), side_by_side=3)
    entries = []
    for number, each in enumerate(found):
        assert len(asked) == min(3 * (number // 3 + 1), 7)
        entries.append(each.entry)
    assert len(entries) == 7
    assert all(entry == entries[0] for entry in entries)


@pytest.mark.parametrize("period_s", [0.1, 0.037])
def test_tables_are_judged_as_o2mon_replay_judges_them(tmp_path: Path, period_s: float) -> None:
    (log,) = (ROOT / "replay_logs").glob("gain_low_*.blf")
    block = RecordingReader(ECU, MODEL.card).read(log)
    paths = []
    for number, kept in enumerate((slice(None), slice(0, -1), slice(0, -3))):
        names = block.names[kept]
        path = tmp_path / f"{number}.csv{'.gz' if number else ''}"
        t_s = np.arange(0.0, 250.0, period_s)
        rows = np.minimum((t_s / 0.1).astype(np.int64) + 1500, len(block.block.t_ns) - 1)
        write_table(path, t_s, list(names), block.block.values[rows][:, kept])
        paths.append(path)
    for path, got in zip(paths, judged(paths, SETUP), strict=True):
        assert got.entry == replayed(path, SETUP)
        assert got.entry["windows"]
