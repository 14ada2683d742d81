"""Work beside a test: in a thread of its own, frames sent at their pace, waiting for it."""

import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import can

from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of


@contextmanager
def beside(work: Callable[[threading.Event], object]) -> Iterator[None]:
    """Let something work until the end of the block, which sets its event and waits for it."""
    over = threading.Event()
    thread = threading.Thread(target=work, args=[over])
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def send_as_driven(
    bus: can.BusABC, script: Iterable[Frame | can.Message], over: threading.Event | None = None
) -> None:
    """Send at the pace of the times, the first one at once, until all is sent or it is over."""
    over, begin_s = over or threading.Event(), time.monotonic()
    messages = [each if isinstance(each, can.Message) else message_of(each) for each in script]
    messages.sort(key=lambda message: message.timestamp)
    for message in messages:
        due_s = begin_s + message.timestamp - messages[0].timestamp
        if over.wait(max(due_s - time.monotonic(), 0.0)):
            return
        bus.send(message)


def until(condition: Callable[[], object], seconds: float = 15.0) -> bool:
    """Wait for a condition; return whether it came."""
    end_s = time.monotonic() + seconds
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    return bool(condition())


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])
