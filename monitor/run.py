"""The real-time loop: one thread that receives, judges, records and reports.

When the bus falls silent the loop makes time marks, frames of its own that only move time. They
go through the pipeline and into the recording alike, so that a replay of the recording gives
exactly the same events.
"""

import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import FrameType
from typing import Any, Final

import can

from monitor.dtc import DtcStore
from monitor.errors import BusError, RecordingError
from monitor.memory import Memory
from monitor.pipeline import DtcChanged, Event, FramePipeline, Tick
from monitor.replay import Setup, frame_counters
from monitor.sinks import Collector, event_line
from monitor.sources import frame_of, log_kind
from monitor.transmit import Transmitter
from monitor.types import Frame

TIME_MARK_ID: Final = 0x1FFFFFFF  # 29 bit, no data: lowest priority, never on the bus
SILENCE_S: Final = 0.5  # after which time marks are made
FIRST_FRAME_S: Final = 10.0  # the same while nothing was ever heard, in wall-clock time
RECEIVE_TIMEOUT_S: Final = 0.1
KEEP: Final = 200_000  # windows (11 days at 10 Hz) and samples of the report (5 h), the latest
RECEIVE_BUFFER_BYTES: Final = 8 << 20  # the default holds about 320 frames


class Clock:
    """Bus time while the bus is silent: the last frame's time plus what has passed since."""

    def __init__(self, monotonic_s: Callable[[], float]) -> None:
        self._monotonic_s = monotonic_s
        self._last_ns = time.time_ns() // 1000 * 1000  # until a frame says what time it is
        self._received_s = monotonic_s()
        self._heard = False

    def heard(self, t_ns: int) -> None:
        """Note the time of a frame that has just come in."""
        self._last_ns, self._received_s, self._heard = t_ns, self._monotonic_s(), True

    def mark(self) -> Frame | None:
        """Return a time mark if the bus has been silent for long enough."""
        silent_s = self._monotonic_s() - self._received_s
        if silent_s < (SILENCE_S if self._heard else FIRST_FRAME_S):
            return None
        # a little behind, so that a frame that comes now is not late
        t_ns = self._last_ns + round((silent_s - RECEIVE_TIMEOUT_S) * 1e6) * 1000
        return Frame(t_ns, TIME_MARK_ID, True, b"")


class Recorder(AbstractContextManager["Recorder"]):
    """Writes every frame the loop has seen, in the order in which it has seen them."""

    def __init__(self, path: Path) -> None:
        log_kind(path)  # what cannot be replayed is not recorded
        try:
            self._writer = can.Logger(path)
        except (OSError, ValueError, NotImplementedError, ImportError) as error:
            raise RecordingError(f"{path}: cannot record: {error}") from None

    def write(self, frame: Frame) -> None:
        """Write one frame with its time in whole microseconds."""
        self._writer.on_message_received(message_of(frame))

    def __exit__(self, *_: object) -> None:
        self._writer.stop()


def message_of(frame: Frame) -> can.Message:
    """Return a frame as python-can's message."""
    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        data=frame.data,
        is_fd=len(frame.data) > 8,
    )


def enlarge_receive_buffer(bus: can.BusABC) -> None:
    """Give SocketCAN's socket room for seconds of traffic; other interfaces keep theirs."""
    own = getattr(bus, "socket", None)
    if isinstance(own, socket.socket):
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


class Loop:
    """One run on a bus.

    memory : fault memory; every change is stored before it is announced
    record : log to write
    transmit : send the monitor's own messages
    say : takes the lines to print
    monotonic_s : clock that says how long the bus has been silent
    """

    def __init__(
        self,
        bus: can.BusABC,
        setup: Setup,
        *,
        memory: Memory | None = None,
        record: Path | None = None,
        transmit: bool = False,
        trace: bool = False,
        say: Callable[[str], None] = print,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus, self._memory, self._say, self._now_s = bus, memory, say, monotonic_s
        store = DtcStore(memory.load() if memory else ())
        store.start_driving_cycle()
        self._setup = setup = setup.of_vehicle(memory) if memory else setup
        self._pipeline = FramePipeline(
            setup.bus_map, setup.model, setup.limits, setup.config, store
        )
        self.collector = Collector(self._pipeline.monitor, trace=trace, keep=KEEP)
        self._transmitter = Transmitter(self._pipeline.monitor) if transmit else None
        self._record_path = record
        self._recorder: Recorder | None = None
        self._clock = Clock(monotonic_s)
        self._stop = False
        self.transmit_errors = self.skipped = 0

    def stop(self, *_: int | FrameType | None) -> None:
        """End the loop after the frame in hand; may be called from a signal handler."""
        self._stop = True

    def run(self, duration_s: float | None = None) -> None:
        """Receive and judge until stopped, or for so long.

        Raises BusError when the interface fails.
        """
        enlarge_receive_buffer(self._bus)
        until_s = None if duration_s is None else self._now_s() + duration_s
        with ExitStack() as stack:
            if self._record_path is None:
                self._bus.set_filters(self._filters())
            else:
                self._recorder = stack.enter_context(Recorder(self._record_path))
            while not self._stop and (until_s is None or self._now_s() < until_s):
                for frame in self._receive():
                    self._take(frame)
        if self._memory:
            monitor, setup = self._pipeline.monitor, self._setup
            self._memory.save(monitor.store.all)
            self._memory.learn(setup.model_sha256, monitor.seen, setup.config.bias)

    def _filters(self) -> list[Any]:
        return [
            {
                "can_id": can_id,
                "can_mask": 0x1FFFFFFF if extended else 0x7FF,
                "extended": extended,
            }
            for can_id, extended in self._pipeline.decoder.identifiers
        ]

    def _receive(self) -> Iterator[Frame]:
        message = receive(self._bus, RECEIVE_TIMEOUT_S)
        if message is None:
            mark = self._clock.mark()
            if mark is not None:
                yield mark
        elif message.is_error_frame or message.is_remote_frame:
            self.skipped += 1
        else:
            frame = frame_of(message)
            self._clock.heard(frame.t_ns)
            yield frame

    def _take(self, frame: Frame) -> None:
        if self._recorder:
            self._recorder.write(frame)
        for event in self._pipeline.push(frame):
            self._handle(event)

    def _handle(self, event: Event) -> None:
        if isinstance(event, DtcChanged) and self._memory:
            self._memory.save([event.dtc])
        self.collector.push(event)
        if self._transmitter:
            self._send(self._transmitter.push(event))
        if not isinstance(event, Tick):
            self._say(event_line(event, self.collector))

    def _send(self, frames: Iterator[Frame]) -> None:
        for frame in frames:
            try:
                self._bus.send(message_of(frame), timeout=0)
            except can.CanError:
                self.transmit_errors += 1

    def result(self, channel: str) -> dict[str, Any]:
        """Return the run as a recording's entry of ``o2mon.replay/1``."""
        counters = frame_counters(self._pipeline) | {
            "skipped": self.skipped,
            "transmit_errors": self.transmit_errors,
        }
        return self.collector.result(channel, None, counters)


def run(loop: Loop, duration_s: float | None) -> None:
    """Run the loop until its time is over or SIGINT or SIGTERM comes."""
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = {number: signal.signal(number, loop.stop) for number in signals}
    try:
        loop.run(duration_s)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def receive(bus: can.BusABC, timeout_s: float) -> can.Message | None:
    """Return the next message, None if none came in time.

    Raises BusError when the interface fails.
    """
    try:
        return bus.recv(timeout_s)
    except (can.CanError, OSError) as error:
        raise BusError(f"{bus.channel_info}: {error}") from None
