"""Address of the live page, and the host names under which browsers may request it."""

import argparse
import ipaddress
import os
import re
import socket
from dataclasses import dataclass
from typing import Final

from monitor.base.errors import UsageError

LOOPBACK: Final = "127.0.0.1"
BACKLOG: Final = 64
SEND_BUFFER_BYTES: Final = 128 << 10  # per browser, in the kernel; its default may grow to 4 MB
_PLACE = re.compile(r"(?:(?:\[([0-9A-Fa-f:.]+)\]|([^\[\]:\s]+)):)?(\d{1,5})")


@dataclass(frozen=True, slots=True)
class PageAddress:
    """A host and a port to listen on; port 0 means any free port."""

    host: str
    port: int

    @property
    def url(self) -> str:
        """Return the page's URL for a browser on this machine."""
        wild = {"0.0.0.0": LOOPBACK, "::": "::1"}
        host = wild.get(self.host, self.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"


def parse(text: str) -> PageAddress:
    """Return the address of HOST:PORT, [IPV6]:PORT, or PORT for the loopback.

    Raises argparse.ArgumentTypeError.

    >>> parse("8765")
    PageAddress(host='127.0.0.1', port=8765)
    """
    match = _PLACE.fullmatch(text)
    if not match or int(match[3]) > 65535:
        raise argparse.ArgumentTypeError(f"{text}: HOST:PORT is wanted, as in {LOOPBACK}:8765")
    return PageAddress(match[1] or match[2] or LOOPBACK, int(match[3]))


def listen(address: PageAddress) -> socket.socket:
    """Return a socket that listens at the address.

    Raises UsageError with the reason if that fails.
    """
    where = f"--live {address.host}:{address.port}"
    try:
        family, *_, place = socket.getaddrinfo(
            address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        server = socket.create_server(place[:2], family=family, backlog=BACKLOG)
    except (OSError, UnicodeError) as error:  # the latter for a name that can be none
        number = getattr(error, "errno", None) or 0  # negative if the name is unknown
        reason = os.strerror(number) if number > 0 else getattr(error, "strerror", error)
        raise UsageError(f"{where}: {reason}") from None
    server.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return server


def is_loopback(server: socket.socket) -> bool:
    """Return whether only this machine can reach a listening socket."""
    return ipaddress.ip_address(server.getsockname()[0]).is_loopback


def may_ask(header: str, host: str, *, loopback: bool) -> bool:
    """Return whether a Host header names this page.

    Another site's name may resolve to this machine (DNS rebinding); an IP address cannot.

    header : the received Host header
    host : host that the user asked to listen on
    loopback : only this machine can reach the page, so only loopback names count
    """
    name = _name(header)
    if name is None:
        return False
    if name in {"localhost", host.lower()}:
        return True
    try:
        ip = ipaddress.ip_address(name)
    except ValueError:
        here = socket.gethostname().lower()
        return not loopback and name in {here, here.partition(".")[0], f"{here}.local"}
    return ip.is_loopback or not loopback


def _name(header: str) -> str | None:
    """Return the host of a Host header in lower case, None if the header is invalid."""
    match = re.fullmatch(r"(?:\[([0-9a-f:.]+)\]|([0-9a-z._-]+))(?::\d{1,5})?", header.lower())
    return (match[1] or match[2]) if match else None
