"""The server process and the pipe to it; the loop never waits for either."""

import json
import subprocess
import sys
from contextlib import suppress
from queue import Queue
from threading import Thread
from typing import IO, Final

from monitor.base.errors import UsageError
from monitor.bus.live.address import PageAddress

END_S: Final = 2.0  # time for the server to end after its pipe is closed
_OWN_GROUP: Final[int] = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)  # Windows alone


class Server:
    """A running server.

    Raises UsageError if it cannot listen at the address.
    """

    def __init__(self, address: PageAddress) -> None:
        self._process = subprocess.Popen(
            # -P: do not import modules from the working folder
            [sys.executable, "-P", "-m", "monitor.bus.live", address.host, str(address.port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in the terminal is for the loop only
            creationflags=_OWN_GROUP,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with self._process.stdout as says:
            said = json.loads(says.readline() or '{"error": "the live page\'s server has died"}')
        if "error" in said:
            self._process.communicate()
            raise UsageError(said["error"])
        self.address = PageAddress(address.host, said["port"])
        self.is_loopback: bool = said["is_loopback"]
        self.pid = self._process.pid
        self._lines: Queue[bytes] = Queue()
        self._writer = Thread(target=self._write, args=[self._process.stdin], daemon=True)
        self._writer.start()

    @property
    def is_free(self) -> bool:
        """Return whether all lines are written.

        Raises BrokenPipeError if the server has died.
        """
        if not self._writer.is_alive():
            raise BrokenPipeError
        return not self._lines.unfinished_tasks

    def send(self, line: bytes) -> None:
        """Write a line without waiting."""
        self._lines.put(line)

    def close(self) -> None:
        """End the server."""
        self._lines.put(b"")
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _write(self, pipe: IO[bytes]) -> None:
        """Write until an empty line comes or the server dies."""
        with suppress(OSError), pipe:
            while line := self._lines.get():
                pipe.write(line)
                pipe.flush()
                self._lines.task_done()
