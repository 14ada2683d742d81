"""State of the page's server: the last minutes for new browsers, the last messages for others.

Memory is bounded whatever the loop sends and however slow a browser is. A browser has no queue,
only a place in a ring of messages; if it falls behind the ring it gets the whole state again.
"""

import asyncio
import json
from collections import deque
from typing import Any, Final

SAMPLES: Final = 6000  # ten minutes at ten samples a second
WINDOWS: Final = 240
RING: Final = 64  # messages, about 16 s
STREAMS: Final = 16  # most browsers at once

_LISTS: Final = ("samples", "windows")


class Hub:
    """Takes the loop's messages and passes them to any number of streams."""

    def __init__(self) -> None:
        self.streams = 0
        self.ended = False
        self._state: dict[str, Any] = {}
        self._kept: dict[str, deque[Any]] = {
            "samples": deque(maxlen=SAMPLES),
            "windows": deque(maxlen=WINDOWS),
        }
        self._ring: deque[bytes] = deque(maxlen=RING)
        self._count = 0  # messages taken so far
        self._news = asyncio.Event()

    def take(self, line: bytes) -> None:
        """Take one message of the loop: a JSON object on one line."""
        message = json.loads(line)
        for name in _LISTS:
            self._kept[name].extend(message.pop(name, ()))
        self._state |= message
        self._announce(b"data: " + line.rstrip() + b"\n\n")

    def end(self) -> None:
        """Tell the browsers that the loop has ended."""
        self.ended = True
        self._announce(b"event: ended\ndata: {}\n\n")

    def _announce(self, event: bytes) -> None:
        self._ring.append(event)
        self._count += 1
        self._news.set()
        self._news = asyncio.Event()

    def snapshot(self) -> bytes:
        """Return the event with the whole state."""
        state = self._state | {name: list(kept) for name, kept in self._kept.items()}
        return b"event: snapshot\ndata: " + json.dumps(state).encode() + b"\n\n"

    async def after(self, place: int | None) -> tuple[int, bytes]:
        """Return the events after ``place``, and the new place; wait if there are none.

        Without a place, or with one that has left the ring, it returns a snapshot.
        """
        while place == self._count:
            await self._news.wait()
        if place is None or self._count - place > len(self._ring):
            return self._count, self.snapshot()
        return self._count, b"".join(list(self._ring)[place - self._count :])
