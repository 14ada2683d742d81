"""InfluxDB's line protocol, and its sinks: HTTP, UDP and a file.

Source: InfluxDB 2 documentation, "Line protocol". "signals" records are the measurement ``o2mon``,
every other record is ``o2mon_event`` with the tag ``kind``. What an event is about (a code, a
window, a fuel cut) is a tag too, so that two events of the same moment are two points.
"""

import http.client
import os
import socket
import ssl
from base64 import b64encode
from collections.abc import Sequence
from typing import Final, TextIO
from urllib.parse import SplitResult, unquote

from monitor.base.errors import UsageError
from monitor.sinks.address import path_of
from monitor.sinks.record import Record, RefusedError, Tags, Value

TIMEOUT_S: Final = 5.0
KEYS: Final = ("code", "of")  # values of events that are tags
DATAGRAM: Final = 1400  # bytes, below the usual limit of a network's packet
REFUSED: Final = (400, 413, 422)  # answers to data that the server will never take
TOKEN: Final = "INFLUX_TOKEN"  # variable of the environment, as InfluxDB's own client reads it
_NAME: Final = str.maketrans({",": r"\,", " ": r"\ ", "=": r"\=", "\n": r"\ ", "\\": "/"})
_TEXT: Final = str.maketrans({'"': r"\"", "\\": r"\\", "\n": " "})


def line(record: Record, tags: Tags) -> str:
    r"""Return a record as one line, time in ns.

    >>> line(Record("code", 7, {"code": "P0133", "status": 47}), {"vehicle": "car 1"})
    'o2mon_event,code=P0133,kind=code,vehicle=car\\ 1 status=47i 7'
    """
    named = dict(tags)
    values = dict(record.values)
    measurement = "o2mon"
    if record.kind != "signals":
        measurement = "o2mon_event"
        named["kind"] = record.kind
        named |= {key: str(values.pop(key)) for key in KEYS if key in values}
    keys = "".join(f",{_name(k)}={_name(v)}" for k, v in sorted(named.items()) if v)
    fields = ",".join(f"{_name(k)}={_field(v)}" for k, v in values.items())
    return f"{measurement}{keys} {fields} {record.t_ns}"


def _name(text: str) -> str:
    return text.translate(_NAME)  # without backslashes, which would escape the next sign


def _field(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return f"{value}i"
    return f"{value:.9g}" if isinstance(value, float) else f'"{value.translate(_TEXT)}"'


class HttpLines:
    """Posts lines to ``/write`` of InfluxDB 1 or ``/api/v2/write`` of 2 and 3.

    The token stands in INFLUX_TOKEN; a user and a password may stand in the address.
    """

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        self._tags = tags
        self._is_safe = url.scheme.endswith("https")
        if not url.hostname:
            raise UsageError("an InfluxDB sink needs a host: influx+http://HOST:8086/write?db=NAME")
        self._host, self._port = url.hostname, url.port or 8086
        path = url.path.rstrip("/")
        query = url.query or ("" if path else "db=o2mon")
        self._path = (path or "/write") + (f"?{query}" if query else "")
        self._headers = {"Content-Type": "text/plain; charset=utf-8"}
        token = os.environ.get(TOKEN)
        if token:
            self._headers["Authorization"] = f"Token {token}"
        elif url.username:
            pair = f"{unquote(url.username)}:{unquote(url.password or '')}"
            self._headers["Authorization"] = f"Basic {b64encode(pair.encode()).decode()}"
        self._connection: http.client.HTTPConnection | None = None

    def write(self, records: Sequence[Record]) -> None:
        """Post the records as one request.

        Raises RefusedError if the server finds fault with the data, OSError if it cannot be reached
        or answers another error.
        """
        connection = self._connection or self._open()
        body = "\n".join(line(record, self._tags) for record in records).encode()
        try:
            connection.request("POST", self._path, body, self._headers)
            answer = connection.getresponse()
            said = answer.read(1000).decode("utf-8", "replace").strip()
        except http.client.HTTPException as error:
            raise OSError(f"no answer of HTTP: {type(error).__name__}") from error
        if answer.status // 100 != 2:
            kind = RefusedError if answer.status in REFUSED else OSError
            raise kind(f"HTTP {answer.status} {said or answer.reason}"[:200])

    def _open(self) -> http.client.HTTPConnection:
        if self._is_safe:
            context = ssl.create_default_context()
            self._connection = http.client.HTTPSConnection(
                self._host, self._port, timeout=TIMEOUT_S, context=context
            )
        else:
            self._connection = http.client.HTTPConnection(self._host, self._port, timeout=TIMEOUT_S)
        return self._connection

    def close(self) -> None:
        """Close the connection."""
        if self._connection:
            self._connection.close()
            self._connection = None


class UdpLines:
    """Sends lines as datagrams; nobody confirms them."""

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        if not url.hostname:
            raise UsageError("a UDP sink needs a host: influx+udp://HOST:8089")
        self._tags, self._address = tags, (url.hostname, url.port or 8089)
        self._socket: socket.socket | None = None

    def write(self, records: Sequence[Record]) -> None:
        """Send the records, as many per datagram as fit.

        Raises OSError if the network refuses one.
        """
        if self._socket is None:
            kind = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(kind[0], socket.SOCK_DGRAM)
            self._socket.connect(kind[4])
        for data in datagrams([line(record, self._tags) for record in records]):
            self._socket.send(data)

    def close(self) -> None:
        """Close the socket."""
        if self._socket:
            self._socket.close()
            self._socket = None


def datagrams(lines: Sequence[str]) -> list[bytes]:
    """Return the lines in as few datagrams as their size permits."""
    made: list[bytes] = []
    for each in lines:
        data = each.encode() + b"\n"
        if made and len(made[-1]) + len(data) <= DATAGRAM:
            made[-1] += data
        else:
            made.append(data)
    return made


class FileLines:
    """Appends lines to a file, for ``influx write`` or Telegraf."""

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        self._path, self._tags = path_of(url), tags
        self._file: TextIO | None = None

    def write(self, records: Sequence[Record]) -> None:
        """Append the records.

        Raises OSError if the file cannot be written.
        """
        if self._file is None:
            self._file = self._path.open("a", encoding="utf-8")
        self._file.writelines(line(record, self._tags) + "\n" for record in records)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        if self._file:
            self._file.close()
            self._file = None
