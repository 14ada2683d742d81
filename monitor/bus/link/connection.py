"""A bus that is opened again after a loss, with growing waits between the attempts."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can

from monitor.base.errors import BusError

FIRST_TRY_S: Final = 0.1  # wait after a loss; it doubles with every failed attempt
LAST_TRY_S: Final = 5.0  # longest wait
STEADY_S: Final = 10.0  # a bus that is back for this time is sound: the waits start small again


class Connection:
    """Keeps a bus and opens it again; a port or a gateway's side, which report its failures.

    bus : None while the bus is lost
    is_lost : True from a loss until the first read without an error
    reopen : opens the bus again; without it a loss is an error
    say : receives a line when the bus is lost and when it is back
    name : begins these lines
    """

    def __init__(
        self,
        bus: can.BusABC,
        reopen: Callable[[], can.BusABC] | None = None,
        say: Callable[[str], None] = print,
        monotonic_s: Callable[[], float] = time.monotonic,
        name: str = "bus",
    ) -> None:
        self.bus: can.BusABC | None = bus
        self.is_lost = False
        self.losses = self.reconnects = 0
        self.name = name
        self._reopen, self._say, self._now_s = reopen, say, monotonic_s
        self._next_try_s = self._lost_s = 0.0
        self._back_s = -math.inf
        self._back_off_s = FIRST_TRY_S
        self._use(bus)

    def _use(self, bus: can.BusABC) -> None:
        """Prepare a bus that was opened."""

    def lose(self, error: Exception) -> None:
        """Shut down a failed bus; raises BusError if there is no ``reopen``."""
        bus, self.bus = self.bus, None
        if self._reopen is None:
            raise BusError(f"{bus and bus.channel_info}: {error}") from None
        if not self.is_lost:
            self.is_lost = True
            self.losses += 1
            self._lost_s = self._now_s()
            if self._lost_s - self._back_s >= STEADY_S:
                self._back_off_s = FIRST_TRY_S
            self._say(f"{self.name}: lost: {error}; it is tried again and again")
        self._next_try_s = self._now_s() + self._back_off_s
        self._back_off_s = min(2.0 * self._back_off_s, LAST_TRY_S)
        if bus:
            _shut_down(bus)

    @property
    def wait_s(self) -> float:
        """Return the time in s until the next attempt to open a lost bus."""
        return max(self._next_try_s - self._now_s(), 0.0) if self.bus is None else 0.0

    def try_again(self) -> can.BusABC | None:
        """Open a lost bus if the next attempt is due; return the bus, None if still lost."""
        if self.wait_s > 0.0:
            return None
        try:
            assert self._reopen is not None
            self.bus = self._reopen()
            self._use(self.bus)
        except (BusError, can.CanError, OSError) as error:
            self.lose(error)
        return self.bus

    def received(self) -> None:
        """Record a read without an error."""
        if self.is_lost:
            self.is_lost = False
            self.reconnects += 1
            self._back_s = self._now_s()
            self._say(f"{self.name}: back after {self._back_s - self._lost_s:.1f} s")

    def close(self) -> None:
        """Shut down a bus that was opened again; the caller owns the first bus."""
        if self.bus is not None and self.losses:
            _shut_down(self.bus)


def _shut_down(bus: can.BusABC) -> None:
    with suppress(can.CanError, OSError):  # the bus is broken already
        bus.shutdown()
