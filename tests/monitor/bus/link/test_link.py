"""The bus of the live loop: receiving, error frames, losses; on a played bus and on a socket."""

import socket
import struct
import time
from collections.abc import Iterable
from typing import Any

import can
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from benchmarks.live.udp_can import UdpCan
from monitor.base.errors import BusError
from monitor.base.types import Frame
from monitor.bus.link.connection import FIRST_TRY_S, LAST_TRY_S
from monitor.bus.link.datagrams import MOST
from monitor.bus.link.error_frames import error_frame
from monitor.bus.link.port import BusHealth, Port
from monitor.bus.link.received import MESSAGES
from monitor.bus.link.recorder import message_of
from monitor.bus.link.socketcan import BEHIND_S, FRAMES, RECEIVE_BUFFER_BYTES, SocketReader
from monitor.frames.blocks import frames_of
from monitor.frames.loop_frames import FIRST_ID
from monitor.grid.block_assembler import LATEST_NS
from tests.helpers.bus.played_bus import PlayedBus
from tests.helpers.examples import inputs

US = 1000
datagrams = st.one_of(
    *(
        st.builds(
            lambda can_id, length, data: struct.pack("=IB3x", can_id, length) + data,
            st.integers(0, 2**32 - 1),
            st.integers(0, size),
            st.binary(min_size=size, max_size=size),
        )
        for size in (8, 64)
    ),
    st.binary(max_size=15),
)


class Bench:
    """A port whose clock moves only while it waits."""

    def __init__(self, bus: can.BusABC, reopened: Iterable[can.BusABC | Exception] = ()) -> None:
        self.now_s = 0.0
        self.said: list[str] = []
        self.health = BusHealth()
        self.tries_s: list[float] = []
        self._reopened = iter(reopened)
        clock = {"monotonic_s": lambda: self.now_s, "sleep": self._wait}
        self.port = Port(bus, self.health, self._open, self.said.append, **clock)

    def receive(self, times: int) -> None:
        for _ in range(times):
            self.port.receive(0.1)

    def _wait(self, seconds: float) -> None:
        self.now_s += seconds

    def _open(self) -> can.BusABC:
        self.tries_s.append(self.now_s)
        found = next(self._reopened)
        if isinstance(found, Exception):
            raise found
        return found


def taken(port: Port, wait_s: float = 0.1, tick_end_ns: int = LATEST_NS) -> list[Frame]:
    return list(frames_of(port.receive(wait_s, tick_end_ns)))


def message(t_s: float = 1.0) -> can.Message:
    return can.Message(timestamp=t_s, arbitration_id=0x123, is_extended_id=False, data=b"\1\2")


def error(can_id: int, *data: int) -> can.Message:
    return can.Message(arbitration_id=can_id, is_error_frame=True, data=bytes(data).ljust(8, b"\0"))


def down() -> can.CanOperationError:
    return can.CanOperationError("Error receiving: Network is down", 100)


def test_a_lost_interface_is_opened_again_and_what_it_then_brings_is_received() -> None:
    # GIVEN an interface that goes away after one frame and is there again at the third try
    first = PlayedBus([message(1.0), down()])
    second = PlayedBus([message(2.0)])
    bench = Bench(first, [BusError("no such device"), OSError(19, "No such device"), second])
    port = bench.port
    assert taken(port) == [Frame(1_000_000_000, 0x123, False, b"\1\2")]
    frames = [frame for _ in range(40) for frame in taken(port)]
    # THEN the frame after the loss comes, the waits double, and the loss was counted once
    assert [frame.t_ns for frame in frames] == [2_000_000_000]
    assert bench.tries_s == pytest.approx([0.1, 0.3, 0.7])
    assert (bench.health.losses, bench.health.reconnects) == (1, 1)
    assert (bench.health.state, port.is_off) == ("active", False)
    assert first.is_shut
    assert len(bench.said) == 2
    assert "Network is down" in bench.said[0]
    assert "back after 0.7 s" in bench.said[1]


def test_the_wait_between_two_tries_stops_growing() -> None:
    bench = Bench(PlayedBus([down()]), [BusError("gone")] * 1000)
    while bench.now_s < 60.0:
        bench.port.receive(0.1)
        assert bench.port.is_off
    waits = [b - a for a, b in zip(bench.tries_s, bench.tries_s[1:], strict=False)]
    assert max(waits) == pytest.approx(LAST_TRY_S)
    assert waits == pytest.approx(sorted(waits))
    assert len(bench.said) == 1


def test_an_interface_that_is_up_and_down_again_is_not_tried_more_and_more_often() -> None:
    flapping = [PlayedBus([down()]) for _ in range(1000)]
    bench = Bench(PlayedBus([down()]), flapping)
    while bench.now_s < 60.0:
        bench.port.receive(0.1)
    assert len(bench.tries_s) < 20


def test_after_an_interface_was_sound_again_its_next_loss_is_tried_at_once() -> None:
    # GIVEN an interface that is lost, back for a minute without a frame at first, and lost again
    lost_for_long = [BusError("gone")] * 6
    steady = PlayedBus([*[None] * 10, message(), *[None] * 10, down()])
    bench = Bench(PlayedBus([down()]), [*lost_for_long, steady, PlayedBus([message()])])
    while bench.health.reconnects < 1:
        bench.port.receive(0.1)
    assert (bench.health.state, bench.port.is_off) == ("active", False)  # though nothing came yet
    back_s = bench.now_s
    bench.now_s += 60.0
    while bench.health.reconnects < 2:
        bench.port.receive(0.1)
    # THEN the first try is as soon as at the first loss
    assert bench.tries_s[-1] == pytest.approx(back_s + 60.0 + FIRST_TRY_S)
    assert bench.health.losses == 2


def test_filters_hold_after_the_interface_came_back() -> None:
    second = PlayedBus([])
    bench = Bench(PlayedBus([down()]), [second])
    bench.port.set_filters({(0x123, False), (0x18DB33F1, True)})
    bench.receive(5)
    assert second.filters == [
        {"can_id": 0x123, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x18DB33F1, "can_mask": 0x1FFFFFFF, "extended": True},
    ]


def test_without_a_way_to_open_it_again_a_loss_is_an_error() -> None:
    port = Port(PlayedBus([down()]), BusHealth())
    with pytest.raises(BusError, match=r"played'?: .*Network is down"):
        port.receive(0.1)


def refuse(*_: object) -> None:
    raise can.CanOperationError("nobody acknowledges")


def test_what_cannot_be_sent_is_counted_and_the_time_of_a_sample_keeps_no_frame_back() -> None:
    lost = PlayedBus([down()])
    lost.send = refuse  # type: ignore[method-assign]
    bench = Bench(lost)
    bench.port.send(Frame(0, 0x5C0, False, bytes(8)))
    bench.port.receive(0.1)  # lost now
    bench.port.send(Frame(0, 0x5C0, False, bytes(8)))
    assert bench.health.transmit_errors == 2
    with can.Bus(interface="serial", channel="loop://") as bus:
        bench = Bench(bus)
        bench.port.send(Frame(1_700_000_000 * 10**9, 0x5C0, False, b"\1"))
        assert (got := bus.recv(1.0)) and got.data == b"\1"
        bench.port.send(Frame(0, 0x5C0, False, bytes(300)))
    assert bench.health.transmit_errors == 1


@pytest.mark.parametrize(
    ("said", "state", "counter"),
    [
        (error(0x40), "bus off", "bus_off"),
        (error(0x04, 0, 0x10), "passive", "passive"),
        (error(0x04, 0, 0x20), "passive", "passive"),
        (error(0x04, 0, 0x04), "warning", "warning"),
        (error(0x04, 0, 0x08), "warning", "warning"),
        (error(0x44, 0, 0x10), "bus off", "bus_off"),
    ],
)
def test_an_error_frame_tells_the_state(said: can.Message, state: str, counter: str) -> None:
    bench = Bench(PlayedBus([said, said]))
    bench.receive(2)  # the same state again is not counted again
    health = bench.health
    assert (health.state, health.error_frames, getattr(health, counter)) == (state, 2, 1)
    assert health.bus_off + health.passive + health.warning == 1
    assert bench.port.is_off == (state == "bus off")


def test_an_error_frame_of_another_interface_is_only_counted() -> None:
    bus = PlayedBus([error(0x40)])
    bus.channel_info = "adapter with error frames of its own"
    bench = Bench(bus)
    bench.port.receive(0.1)
    assert (bench.health.state, bench.health.error_frames) == ("active", 1)


def test_overflow_and_missing_acknowledge_are_counted_and_change_no_state() -> None:
    bench = Bench(PlayedBus([error(0x04, 0, 0x01), error(0x20), error(0x08, 0, 0x01)]))
    bench.receive(3)
    health = bench.health
    assert (health.overruns, health.unacknowledged, health.error_frames) == (1, 1, 3)
    assert health.state == "active"


@pytest.mark.parametrize("back", [error(0x100), error(0x04, 0, 0x40), message()])
def test_a_controller_comes_back_by_its_word_or_by_a_frame(back: can.Message) -> None:
    bench = Bench(PlayedBus([error(0x40), None, None, back]))
    bench.receive(2)
    assert bench.port.is_off  # silence proves nothing
    bench.port.receive(0.1)
    assert (bench.health.state, bench.port.is_off) == ("active", False)


def test_a_controller_that_goes_and_comes_is_told_of_once_in_a_while() -> None:
    bench = Bench(PlayedBus([error(0x40), message()] * 20))
    bench.receive(40)
    assert (bench.health.bus_off, len(bench.said)) == (20, 1)


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_any_error_frame_is_survived(can_id: int, data: bytes) -> None:
    said = error_frame(can_id, data)
    assert (said.state == "bus off") == bool(can_id & 0x40)


# The socket of SocketCAN, played by a UDP socket that carries the same struct can_frame.


@pytest.fixture
def wire() -> Iterable[tuple[UdpCan, UdpCan]]:
    there = UdpCan()
    here = UdpCan(peer=there.address)
    with there, here:
        yield here, there


def send(here: UdpCan, numbers: Iterable[int]) -> None:
    for number in numbers:
        here.send_raw(struct.pack("=IB3x8x", number, 8))


def received(port: Port, n: int) -> list[Frame]:
    frames: list[Frame] = []
    until_s = time.monotonic() + 5.0
    while len(frames) < n and time.monotonic() < until_s:
        frames += taken(port)
    return frames


def test_the_time_of_a_frame_off_the_socket_is_the_kernels_in_whole_microseconds(wire: Any) -> None:
    here, there = wire
    here.send(message())
    health = BusHealth()
    (frame,) = received(Port(there, health), 1)
    assert frame.t_ns % US == 0
    assert abs(frame.t_ns - time.time_ns()) < 5e9
    assert (health.frames, health.timestamps) == (1, "kernel")
    assert message_of(frame).timestamp == pytest.approx(frame.t_ns / 1e9, abs=1e-7)


def test_dropped_frames_are_counted_once_however_often_a_lost_bus_is_tried(wire: Any) -> None:
    # GIVEN a socket that has dropped frames, and then fails
    here, there = wire
    with UdpCan() as second:
        bench = Bench(there, [BusError("gone"), BusError("gone"), second])
        there.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        send(here, range(300))
        n = len(taken(bench.port, 0.0))
        send(here, [1])  # tells what was dropped before it
        n += len(taken(bench.port, 0.0))
        there.socket.close()
        # WHEN it is there again at the third try
        while bench.health.reconnects < 1:
            bench.port.receive(0.1)
        bench.port.receive(0.0)
    assert (bench.health.losses, bench.health.drops) == (1, 301 - n)
    assert n < 301


def test_the_buffer_is_enlarged_and_what_was_got_is_known(wire: Any) -> None:
    _, there = wire
    health = BusHealth()
    Port(there, health)
    got = there.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    assert RECEIVE_BUFFER_BYTES >= health.receive_buffer_bytes == got > 200_000


def test_frames_gather_until_the_ticks_end_and_are_read_with_one_call(
    wire: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN frames, others that come while these wait, and a tick whose end is near or far
    here, there = wire
    port, waits_s = Port(there, BusHealth()), list[float]()

    def sleep(seconds: float) -> None:
        waits_s.append(seconds)
        send(here, range(50, 60))

    now_ns = time.time_ns()
    monkeypatch.setattr("monitor.bus.link.socketcan.time.sleep", sleep)
    monkeypatch.setattr("monitor.bus.link.socketcan.time.time_ns", lambda: now_ns)
    for ahead_s in (0.010, 60.0):
        send(here, range(50))
        frames = taken(port, 1.0, now_ns + round(ahead_s * 1e9))
        # THEN all come at once, in their order, when the tick or the longest wait is over
        assert [frame.can_id for frame in frames] == list(range(60))
        assert 0.0 < waits_s.pop() <= min(ahead_s + BEHIND_S, 1.0)
    # AND behind the tick's end a frame does not wait for others
    send(here, [60])
    assert len(taken(port, 1.0, now_ns - 1_000_000)) == 1
    assert waits_s == []


@pytest.mark.parametrize("n", [FRAMES - 1, FRAMES, 2 * FRAMES + 7])
def test_more_frames_than_one_call_takes_are_read_by_the_next(n: int, wire: Any) -> None:
    here, there = wire
    port = Port(there, BusHealth())
    send(here, (k % 0x600 for k in range(n)))
    found = [frame.can_id for _ in range(4) for frame in taken(port, 0.0)]
    assert found == [k % 0x600 for k in range(n)]


REMOTE_AND_ERROR = [0x40000123, 0xC0000123, 0x20000004, 0x123]


@inputs(60)
@given(frames=st.lists(datagrams, max_size=30))
@example(frames=[struct.pack("=IB3x8x", number, 8) for number in REMOTE_AND_ERROR])
def test_any_datagrams_are_read_as_struct_can_frame_says(frames: list[bytes]) -> None:
    health = BusHealth()
    with UdpCan() as there, UdpCan(peer=there.address) as here:
        port = Port(there, health)
        for frame in frames:
            here.send_raw(frame)
        found = [frame for _ in range(2) for frame in taken(port, 0.0)]
    whole = [frame for frame in frames if len(frame) in (16, 72)]
    ids = [struct.unpack_from("=I", frame)[0] for frame in whole]
    odd = [number for number in ids if number & 0x60000000]
    assert [frame[1:] for frame in found] == [
        (number & 0x1FFFFFFF, number >= 1 << 31, frame[8 : 8 + frame[4]])
        for number, frame in zip(ids, whole, strict=True)
        if number not in odd and number < FIRST_ID | 1 << 31
    ]
    assert health.malformed == len(frames) - len(whole)
    assert health.error_frames == sum(bool(number & 0x20000000) for number in odd)
    assert health.error_frames + health.remote_frames == len(odd)


def test_frames_without_a_stamp_of_the_kernel_have_the_time_0() -> None:
    # GIVEN datagrams of another family, which nobody stamps
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with here, there:
        here.send(struct.pack("=IB3x8s", 0x123, 2, b"\1\2"))
        received = SocketReader(there).receive(0.1, 0)
    assert list(frames_of(received.block)) == [Frame(0, 0x123, False, b"\1\2")]


def test_a_socket_that_fails_raises(wire: Any) -> None:
    # GIVEN a socket that the kernel tells of an error: nobody is where it sent to
    reader = SocketReader.of(wire[1])
    assert reader is not None
    stranger = UdpCan()
    wire[1].socket.connect(stranger.address)
    stranger.shutdown()
    wire[1].socket.send(b"x")
    with pytest.raises(OSError, match="refused"):
        reader.receive(0.1, 0)


def test_a_silent_socket_gives_back_the_thread_in_time(wire: Any) -> None:
    port = Port(wire[1], BusHealth())
    for timeout_s in (0.0, 0.01, 0.1):
        start_s = time.monotonic()
        assert taken(port, timeout_s) == []
        assert time.monotonic() - start_s < timeout_s + 0.15


def unreadable() -> can.CanOperationError:
    """Return the error that python-can's UDP interface raises on a datagram it cannot unpack."""
    error = can.CanOperationError("could not unpack received message")
    error.__cause__ = ValueError("unpack(b) received extra data")
    return error


def test_a_malformed_datagram_is_counted_and_the_bus_stays() -> None:
    frame = can.Message(arbitration_id=1, data=b"\1")
    spoilt = can.Message(arbitration_id=1, data=b"\1", timestamp=float("nan"))
    script = [unreadable(), TypeError("not a mapping"), spoilt, None, frame]
    bench = Bench(PlayedBus(script))
    received = [frame for _ in script for frame in taken(bench.port)]
    assert [frame.data for frame in received] == [b"\1"]
    assert (bench.health.malformed, bench.health.losses, bench.health.state) == (3, 0, "active")
    assert bench.said == []


def test_messages_that_come_together_are_one_block_up_to_a_ticks_end_or_a_loss() -> None:
    script = [message(1.0), message(1.1), message(1.2), message(1.3), down()]
    bench = Bench(PlayedBus(script), [PlayedBus([])])
    first = taken(bench.port, 0.1, round(1.05 * 1e9))
    assert [frame.t_ns / 1e9 for frame in first] == [1.0, 1.1]
    assert len(taken(bench.port)) == 2  # what was received before the loss is there
    assert bench.health.losses == 0
    assert taken(bench.port) == []
    assert (bench.health.losses, bench.port.is_off) == (1, True)


def test_an_interface_that_reads_nothing_but_errors_is_lost() -> None:
    bench = Bench(PlayedBus(unreadable() for _ in range(MOST + 1)), [PlayedBus([])])
    bench.receive(MOST + 1)
    assert (bench.health.malformed, bench.health.losses) == (MOST, 1)


def test_a_storm_of_error_frames_gives_the_loop_back() -> None:
    # GIVEN a bus at a wrong bit rate, on which error frames come without end
    errors = [can.Message(is_error_frame=True) for _ in range(3 * MESSAGES)]
    bench = Bench(PlayedBus(errors))
    # WHEN the port looks once THEN it comes back with a part of them
    bench.port.receive(0.1)
    assert bench.health.error_frames == MESSAGES
