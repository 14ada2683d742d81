"""The bus of the live loop: receive, send, watch its health, open it again after a loss."""

import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Final, Literal

import can
import numpy as np

from monitor.base.types import Frame, FrameBlock
from monitor.bus.link.connection import Connection
from monitor.bus.link.error_frames import error_frame
from monitor.bus.link.received import NOTHING, MessageReader, Received
from monitor.bus.link.recorder import message_of
from monitor.bus.link.socketcan import SocketReader
from monitor.frames.blocks import EXTENDED, chosen
from monitor.frames.loop_frames import FIRST_ID
from monitor.grid.block_assembler import LATEST_NS

ANSWER_S: Final = 0.02  # longest wait where frames are answered, such as diagnostic requests
QUIET_S: Final = 10.0  # least time between two messages about the controller's state

State = Literal["active", "warning", "passive", "bus off", "gone"]
OFF: Final = ("bus off", "gone")


@dataclass(slots=True)
class BusHealth:
    """Counters and state of the bus and of the loop."""

    state: State = "active"  # of the controller; "gone" means that the interface is lost
    frames: int = 0  # received data frames, without the refused ones
    error_frames: int = 0
    remote_frames: int = 0
    refused: int = 0  # frames under identifiers reserved for the loop
    overruns: int = 0  # error frames that report frames lost in the controller
    drops: int | None = None  # frames lost because the socket's buffer was full, None if unknown
    malformed: int = 0  # datagrams that the interface could not read
    bus_off: int = 0  # times the controller went off the bus
    passive: int = 0  # times it became error passive
    warning: int = 0  # times its error counters reached the warning limit
    unacknowledged: int = 0  # error frames that report a missing acknowledgement
    losses: int = 0  # times the interface was lost
    reconnects: int = 0  # times the interface came back
    transmit_errors: int = 0
    stale: tuple[str, ...] = ()  # signals that are stale now
    absent: tuple[str, ...] = ()  # signals of the map that not every vehicle sends, never received
    stale_samples: int = 0  # samples with a stale signal
    memory_errors: int = 0  # failed attempts to store the fault memory
    detached: int = 0  # attachments removed after an exception
    sinks_off: tuple[str, ...] = ()  # sinks that take nothing now
    sinks_sent: int = 0  # records that the sinks took
    sinks_dropped: int = 0  # records that found no room in a queue, or that a sink refused
    sinks_lost: int = 0  # times a sink was lost
    receive_buffer_bytes: int = 0  # of the SocketCAN socket, 0 if unknown
    timestamps: Literal["kernel", "interface"] = "interface"


class Port(Connection):
    """One bus, used by one thread.

    health : updated by the port
    reopen : opens the bus again after a loss; without it a loss is an error
    say : receives messages about losses
    """

    def __init__(
        self,
        bus: can.BusABC,
        health: BusHealth,
        reopen: Callable[[], can.BusABC] | None = None,
        say: Callable[[str], None] = print,
        monotonic_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._health, self._sleep = health, sleep
        self._filters: list[Any] | None = None
        self._quiet_until_s = -math.inf
        self._drops_before: int | None = 0  # frames dropped on earlier sockets, None if unknown
        super().__init__(bus, reopen, say, monotonic_s)

    def _use(self, bus: can.BusABC) -> None:
        reader = SocketReader.of(bus)
        self._reader = reader or MessageReader(bus, self._now_s)
        self._is_socketcan = bool(reader) or bus.channel_info.startswith("socketcan")
        if self._filters is not None:
            bus.set_filters(self._filters)
        if reader:
            self._health.receive_buffer_bytes = reader.buffer_bytes
            self._health.timestamps = "kernel"
        self._count_drops()

    @property
    def is_off(self) -> bool:
        """Return whether the monitor cannot hear the bus."""
        return self._health.state in OFF

    def set_filters(
        self, identifiers: Collection[tuple[int, bool]], groups: Collection[tuple[int, int]] = ()
    ) -> None:
        """Receive only these frames, given as identifier and whether it has 29 bits.

        groups : bits of 29-bit identifiers and their mask
        """
        self._filters = [
            {"can_id": can_id, "can_mask": 0x1FFFFFFF if long else 0x7FF, "extended": long}
            for can_id, long in sorted(identifiers)
        ]
        self._filters += [
            {"can_id": group, "can_mask": mask, "extended": True} for group, mask in sorted(groups)
        ]
        if self.bus:
            self.bus.set_filters(self._filters)

    def receive(self, wait_s: float, tick_end_ns: int = LATEST_NS) -> FrameBlock:
        """Return the frames that come within ``wait_s``, as one block, empty if none does.

        tick_end_ns : bus time before which no frame is urgent, so that they may gather
        Raises BusError if the interface fails and cannot be opened again.
        """
        if self.bus is None:
            if self.wait_s > 0.0:
                self._sleep(min(self.wait_s, wait_s))
            else:
                self.try_again()
            return NOTHING.block
        try:
            received = self._reader.receive(wait_s, tick_end_ns)
        except Exception as error:  # python-can's interfaces raise any
            self.lose(error)
            return NOTHING.block
        return self._take(received)

    def _take(self, received: Received) -> FrameBlock:
        """Update the health; return the frames that may be judged."""
        health, block = self._health, received.block
        health.remote_frames += received.remote
        health.malformed += received.malformed
        self._count_drops()
        at = 0
        for error in received.errors:
            self._hear(error.place - at)
            at = error.place
            if self._is_socketcan:
                self._heed(error.can_id, error.data)
            else:  # other interfaces have other formats
                health.error_frames += 1
        if at < len(block.key) or not received.malformed:
            self._hear(len(block.key) - at)
        refused = block.key >= FIRST_ID | EXTENDED
        if refused.any():
            health.refused += int(np.count_nonzero(refused))
            block = chosen(block, ~refused)
        health.frames += len(block.key)
        return block

    def _hear(self, n: int) -> None:
        """Note a read without an error, of so many frames."""
        health = self._health
        if health.state in OFF:
            self.received()
            health.reconnects = self.reconnects
            if health.state == "gone" or n:
                health.state = "active"

    def _count_drops(self) -> None:
        """Add up the frames dropped on all sockets; None if one of them does not tell."""
        own, before = self._reader.drops, self._drops_before
        self._health.drops = None if own is None or before is None else before + own

    def _heed(self, can_id: int, data: bytes) -> None:
        """Update the health from a SocketCAN error frame."""
        health, meaning = self._health, error_frame(can_id, data)
        health.error_frames += 1
        health.overruns += meaning.overflow
        health.unacknowledged += meaning.no_acknowledge
        if meaning.state is None or meaning.state == health.state:
            return
        health.state = meaning.state
        health.bus_off += meaning.state == "bus off"
        health.passive += meaning.state == "passive"
        health.warning += meaning.state == "warning"
        if meaning.state in ("bus off", "passive") and self._now_s() >= self._quiet_until_s:
            self._quiet_until_s = self._now_s() + QUIET_S
            kind = f"{'error ' * (meaning.state == 'passive')}{meaning.state}"
            self._say(f"bus: the controller is {kind}")

    def lose(self, error: Exception) -> None:
        """Give up a failed bus and schedule its opening."""
        self._drops_before = self._health.drops
        self._health.state = "gone"
        super().lose(error)
        self._health.losses = self.losses

    def send(self, frame: Frame) -> None:
        """Send a frame; count it as a transmit error if that fails."""
        try:
            if self.bus is None:
                raise can.CanOperationError("the bus is lost")
            # without a time, which is that of a sample: some interfaces pass it on, or refuse it
            self.bus.send(message_of(frame._replace(t_ns=0)), timeout=0)
        except Exception:  # python-can's interfaces raise any
            self._health.transmit_errors += 1
