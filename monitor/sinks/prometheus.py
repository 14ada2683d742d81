"""Prometheus: the latest values as text, at an address to scrape or in a file.

Source: Prometheus documentation, "Exposition formats", text format 0.0.4. A signal's metric is its
path with underscores for points; the file is for the textfile collector of the node exporter.
"""

import os
import threading
from collections.abc import Sequence
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final
from urllib.parse import SplitResult

from monitor.base.errors import UsageError
from monitor.sinks.address import path_of
from monitor.sinks.record import Record, Tags, Value

PORT: Final = 9464  # usual port of OpenTelemetry's exporter of metrics
KIND: Final = "text/plain; version=0.0.4; charset=utf-8"
VERDICTS: Final = ("passed", "failed", "inconclusive")
_LABEL: Final = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


class Page:
    """The latest signals, and counters of events."""

    def __init__(self, tags: Tags) -> None:
        self._tags = dict(tags)
        self._signals: dict[str, Value] = {}
        self._codes: dict[str, tuple[int, str, str]] = {}  # code: status byte, fault, state
        self._verdict: tuple[str, str] | None = None
        self._counts = {"code": 0, "cycle": 0, "verdict": 0}

    def take(self, record: Record) -> None:
        """Note a record."""
        values = record.values
        if record.kind == "signals":
            self._signals = dict(values)
            return
        self._counts[record.kind] = self._counts.get(record.kind, 0) + 1
        if record.kind == "code":
            self._codes[str(values["code"])] = (
                int(values["status"]),
                str(values["fault"]),
                str(values["state"]),
            )
        elif record.kind == "verdict" and values.get("of") == "window":
            self._verdict = str(values["verdict"]), str(values["fault"])

    def text(self) -> str:
        """Return the page in the text format."""
        lines: list[str] = []
        for path, value in self._signals.items():
            name = path.replace(".", "_")
            lines.append(f"# TYPE {name} gauge")
            if isinstance(value, str):
                lines.append(self._line(name, 1, value=value or "nothing"))
            else:
                lines.append(self._line(name, value))
        lines.append("# TYPE o2mon_events_total counter")
        lines += [self._line("o2mon_events_total", n, kind=k) for k, n in self._counts.items()]
        if self._verdict:
            fault = self._verdict[1]
            lines.append("# TYPE o2mon_verdict gauge")
            for each in VERDICTS:
                own = {"verdict": each, "fault": fault if each == self._verdict[0] else ""}
                lines.append(self._line("o2mon_verdict", each == self._verdict[0], **own))
        if self._codes:
            lines.append("# TYPE o2mon_code_status gauge")
            for code, (status, fault, state) in self._codes.items():
                own = {"code": code, "fault": fault, "state": state}
                lines.append(self._line("o2mon_code_status", status, **own))
        return "\n".join(lines) + "\n"

    def _line(self, name: str, number: float, **own: str) -> str:
        labels = {k: v for k, v in (self._tags | own).items() if v}
        inner = ",".join(f'{k}="{v.translate(_LABEL)}"' for k, v in labels.items())
        return f"{name}{{{inner}}} {float(number):.9g}" if inner else f"{name} {float(number):.9g}"


class Scraped:
    """Serves the page at ``http://HOST:PORT/metrics``.

    Raises UsageError if it cannot listen.
    """

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        self._page, self._lock = Page(tags), threading.Lock()
        host, port = url.hostname or "127.0.0.1", PORT if url.port is None else url.port
        try:
            self._server = ThreadingHTTPServer((host, port), _handler(self))
        except OSError as error:
            raise UsageError(f"cannot serve metrics at {host}:{port}: {error.strerror}") from None
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        threading.Thread(
            target=self._server.serve_forever, args=[0.2], name="metrics", daemon=True
        ).start()

    def text(self) -> str:
        """Return the page."""
        with self._lock:
            return self._page.text()

    def write(self, records: Sequence[Record]) -> None:
        """Note the records."""
        with self._lock:
            for record in records:
                self._page.take(record)

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()


def _handler(scraped: Scraped) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 5.0  # of a client that sends nothing

        def do_GET(self) -> None:
            if self.path.partition("?")[0] not in ("/metrics", "/"):
                self.send_error(404)
                return
            body = scraped.text().encode()
            self.send_response(200)
            self.send_header("Content-Type", KIND)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            with suppress(OSError):
                self.wfile.write(body)

        def log_message(self, *_: object) -> None:  # the run's output is not a web server's
            pass

    return Handler


class TextFile:
    """Writes the page into a file, in one step."""

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        self._path, self._page = path_of(url), Page(tags)

    def write(self, records: Sequence[Record]) -> None:
        """Note the records and write the page.

        Raises OSError if the file cannot be written.
        """
        for record in records:
            self._page.take(record)
        # a collector reads files named *.prom, so the other name must not end so
        beside = self._path.with_name(f"{self._path.name}.{os.getpid()}")
        beside.write_text(self._page.text(), encoding="utf-8")
        beside.replace(self._path)

    def close(self) -> None:
        """Leave the file with the latest values."""
