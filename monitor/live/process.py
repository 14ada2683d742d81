"""The server as a child process, and the pipe to it that is never waited for."""

import contextlib
import importlib.util
import os
import subprocess
import sys
from typing import Final

from monitor.errors import UsageError
from monitor.live.address import Address, is_loopback, listen

NEEDED: Final = ("starlette", "uvicorn")
END_S: Final = 2.0  # for the server to end after its pipe is closed


class Server:
    """A running server.

    Raises UsageError if its libraries are missing, or if it cannot listen at the address.
    """

    def __init__(self, address: Address) -> None:
        missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
        if missing:
            raise UsageError(
                f"--live needs {' and '.join(missing)}: pip install 'o2-monitor[live]'"
            )
        with listen(address) as listening:
            self.address = Address(address.host, listening.getsockname()[1])
            self.is_loopback = is_loopback(listening)
            number = listening.fileno()
            self._process = subprocess.Popen(
                # -P: no module of the folder it is started in
                [sys.executable, "-P", "-m", "monitor.live", str(number), address.host],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=[number],
                start_new_session=True,  # the terminal's Ctrl-C is for the loop
            )
        assert self._process.stdin is not None
        self._writer = self._process.stdin
        self._pipe = self._writer.fileno()
        os.set_blocking(self._pipe, False)
        self._unsent = b""

    @property
    def pid(self) -> int:
        """Return the server's process number."""
        return self._process.pid

    @property
    def is_free(self) -> bool:
        """Return whether nothing waits to be taken; tries to bring it away first.

        Raises BrokenPipeError when the server has died.
        """
        if self._unsent:
            self.send(b"")
        return not self._unsent

    def send(self, line: bytes) -> None:
        """Send a line without waiting; what the pipe has no room for is kept.

        Raises BrokenPipeError when the server has died.
        """
        self._unsent += line
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._pipe, self._unsent) :]

    def close(self) -> None:
        """End the server."""
        process = self._process
        with contextlib.suppress(BrokenPipeError):
            self._writer.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
