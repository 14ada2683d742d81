"""The server process and the pipe to it; writing to the pipe never waits."""

import contextlib
import os
import subprocess
import sys
from typing import Final

from monitor.bus.live.address import PageAddress, is_loopback, listen

END_S: Final = 2.0  # time for the server to end after its pipe is closed


class Server:
    """A running server.

    Raises UsageError if it cannot listen at the address.
    """

    def __init__(self, address: PageAddress) -> None:
        with listen(address) as listening:
            self.address = PageAddress(address.host, listening.getsockname()[1])
            self.is_loopback = is_loopback(listening)
            number = listening.fileno()
            self._process = subprocess.Popen(
                # -P: do not import modules from the working folder
                [sys.executable, "-P", "-m", "monitor.bus.live", str(number), address.host],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=[number],
                start_new_session=True,  # Ctrl-C in the terminal is for the loop only
            )
        assert self._process.stdin is not None
        self._writer, self.pid = self._process.stdin, self._process.pid
        self._pipe = self._writer.fileno()
        self._unsent = b""
        os.set_blocking(self._pipe, False)

    @property
    def is_free(self) -> bool:
        """Return whether all data is written, after trying to write the rest.

        Raises BrokenPipeError if the server has died.
        """
        if self._unsent:
            self.send(b"")
        return not self._unsent

    def send(self, line: bytes) -> None:
        """Write a line without waiting; the part that does not fit into the pipe is kept.

        Raises BrokenPipeError if the server has died.
        """
        self._unsent += line
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._pipe, self._unsent) :]

    def close(self) -> None:
        """End the server."""
        with contextlib.suppress(BrokenPipeError):
            self._writer.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
