"""Reports to systemd that the loop is ready, alive or ending; see sd_notify(3)."""

import math
import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress

from monitor.base.types import Frame
from monitor.bus.attachment import Attachment

STATUS_S = 10.0  # between two status lines


class Watchdog(Attachment):
    """Notifies the service manager, while the loop goes round.

    address : the manager's socket, a path or "@" and an abstract name
    watchdog_s : silence after which the manager restarts the service, None if it does not watch
    status : returns one line about the loop
    """

    def __init__(self, address: str, watchdog_s: float | None, status: Callable[[], str]) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)  # a manager that hangs does not hold up the loop
        self._watchdog_s = math.inf if watchdog_s is None else watchdog_s / 2.0
        self._status = status
        self._is_ready = False
        self._alive_s = self._status_s = -math.inf

    @classmethod
    def of(
        cls, status: Callable[[], str], environment: Mapping[str, str] = os.environ
    ) -> "Watchdog | None":
        """Return the notifier that the environment asks for, None outside a service."""
        address = environment.get("NOTIFY_SOCKET", "")
        if not address.startswith(("/", "@")):
            return None
        microseconds = environment.get("WATCHDOG_USEC", "")
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watched = microseconds.isdecimal() and int(microseconds) > 0 and ours
        return cls(address, int(microseconds) * 1e-6 if watched else None, status)

    @property
    def due_s(self) -> float:
        """Return when the next notification is due."""
        return min(self._alive_s, self._status_s)

    def work(self, now_s: float) -> tuple[Frame, ...]:
        """Send the notification that is due; no frame is sent."""
        said = []
        if not self._is_ready:
            self._is_ready = True
            said.append("READY=1")
        if now_s >= self._alive_s:
            self._alive_s = now_s + self._watchdog_s
            if self._watchdog_s < math.inf:
                said.append("WATCHDOG=1")
        if now_s >= self._status_s:
            self._status_s = now_s + STATUS_S
            said.append(f"STATUS={self._status()}")
        self._tell(said)
        return ()

    def close(self) -> None:
        """Say that the service ends."""
        self._tell(["STOPPING=1"])
        self._socket.close()

    def _tell(self, said: list[str]) -> None:
        if said:
            with suppress(OSError):  # nobody listens
                self._socket.sendto("\n".join(said).encode(), self._address)
