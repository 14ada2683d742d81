"""The server process and the pipe to it; writing to the pipe never waits."""

import contextlib
import os
import signal
import subprocess
import sys
from typing import Final

from monitor.base.errors import UsageError
from monitor.bus.live.address import PageAddress, is_loopback, listen

END_S: Final = 2.0  # time for the server to end after its pipe is closed
TOLD_BYTES: Final = 4096  # most read from the keeper, which writes a line per started server
GREETING: Final = b'{"version":'  # start of the first message to a server


class Server:
    """A running server; a keeper starts it again when it dies.

    Raises UsageError if it cannot listen at the address.
    """

    def __init__(self, address: PageAddress) -> None:
        with listen(address) as listening:
            self.address = PageAddress(address.host, listening.getsockname()[1])
            self.is_loopback = is_loopback(listening)
            number = listening.fileno()
            self._keeper = subprocess.Popen(
                # -P: do not import modules from the working folder
                [sys.executable, "-P", "-m", "monitor.bus.live.keeper", str(number), address.host],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=[number],
                start_new_session=True,  # Ctrl-C in the terminal is for the loop only
            )
        assert self._keeper.stdin is not None
        assert self._keeper.stdout is not None
        self._writer, self._reader = self._keeper.stdin, self._keeper.stdout
        self._pipe = self._writer.fileno()
        self._unsent = b""
        self._n_started = 0
        self._listen()
        for pipe in (self._writer, self._reader):
            os.set_blocking(pipe.fileno(), False)
        if not self._n_started:
            self.close()
            raise UsageError("--live: the page's server could not be started")

    def _listen(self) -> None:
        """Read the process numbers of started servers from the keeper."""
        with contextlib.suppress(BlockingIOError):
            told = os.read(self._reader.fileno(), TOLD_BYTES).split()
            self._n_started += len(told)
            if told:
                self.pid = int(told[-1])  # process number of the latest server

    @property
    def restarts(self) -> int:
        """Return how many times a dead server was started again."""
        self._listen()
        return self._n_started - 1

    @property
    def is_free(self) -> bool:
        """Return whether all data is written, after trying to write the rest.

        Raises BrokenPipeError if server and keeper have died.
        """
        if self._unsent:
            self.send(b"")
        return not self._unsent

    def send(self, line: bytes) -> None:
        """Write a line without waiting; the part that does not fit into the pipe is kept.

        Raises BrokenPipeError if server and keeper have died.
        """
        self._unsent += line
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._pipe, self._unsent) :]

    def close(self) -> None:
        """End the server and its keeper."""
        with contextlib.suppress(BrokenPipeError):
            self._writer.close()
        try:
            self._keeper.wait(END_S)
        except subprocess.TimeoutExpired:
            os.killpg(self._keeper.pid, signal.SIGKILL)
            self._keeper.wait()
        self._reader.close()
