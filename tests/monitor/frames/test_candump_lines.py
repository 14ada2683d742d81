"""Lines of a candump log: python-can writes and reads the same."""

import io

import can
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of
from monitor.frames.blocks import block_of
from monitor.frames.text.candump import frame_of_line
from monitor.frames.text.candump_lines import lines_of
from tests.helpers.examples import inputs

US = 1000
data = st.one_of(st.binary(max_size=8), st.sampled_from([12, 16, 64]).map(bytes))
times = st.one_of(st.integers(0, 10**10), st.integers(0, 1_800_000_000_000_000))
frames = st.one_of(
    st.builds(Frame, times.map(lambda t: t * US), st.integers(0, 0x7FF), st.just(False), data),
    st.builds(Frame, times.map(lambda t: t * US), st.integers(0, 2**29 - 1), st.just(True), data),
)


@inputs(200)
@given(st.lists(frames, min_size=1, max_size=20))
def test_a_block_has_the_lines_that_python_can_writes(sent: list[Frame]) -> None:
    text = io.StringIO()
    writer = can.CanutilsLogWriter(text)
    writer.last_timestamp = 0.0  # of earlier frames: times that step back stay as they are
    for frame in sent:
        writer.on_message_received(message_of(frame))
    assert lines_of(block_of(sent)).decode() == text.getvalue()


@inputs(100)
@given(st.lists(frames, max_size=20), st.integers(-(10**12), 10**12))
def test_a_block_is_read_as_it_was_written_at_any_time(sent: list[Frame], shift_us: int) -> None:
    moved = [frame._replace(t_ns=frame.t_ns + shift_us * US) for frame in sent]
    lines = lines_of(block_of(moved)).decode().splitlines()
    assert list(map(frame_of_line, lines)) == moved
