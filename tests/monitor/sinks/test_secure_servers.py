"""Sinks behind TLS and tokens: mosquitto with a certificate, the write endpoint of InfluxDB 2."""

import json
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from monitor.sinks.address import open_sink
from monitor.sinks.record import Record, RefusedError
from tests.helpers.servers import free_port, program, running, wait_for
from tests.monitor.sinks.test_servers import Subscriber, code, signals

TOKEN, BUCKET = "a-token==", "o2mon"
POINT = re.compile(  # a line: measurement with tags, fields, time in ns
    r"[^ ,]+(?:,(?:\\.|[^ ,=])+=(?:\\.|[^ ,=])+)* "
    r"(?:(?:\\.|[^ ,=])+=(?:\"(?:\\.|[^\"\\])*\"|-?\d+i|true|false|-?\d[\d.e+-]*),?)+ \d+"
)


def certificate(folder: Path) -> tuple[Path, Path]:
    """Return certificate and key of a broker called localhost, which signs for itself."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    own, key = folder / "broker.pem", folder / "broker.key"
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"]
    files = ["-keyout", str(key), "-out", str(own)]
    subprocess.run([*command.split(), *names, *files], check=True, capture_output=True)
    return own, key


# paho leaves the socket of a refused certificate to the garbage collector
@pytest.mark.filterwarnings("ignore:.*SSLSocket:pytest.PytestUnraisableExceptionWarning")
def test_a_broker_behind_tls_gets_the_events_and_a_strange_one_gets_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a broker with a certificate, and a second port of it without
    own, key = certificate(tmp_path)
    safe, plain = free_port(), free_port()
    settings = tmp_path / "mosquitto.conf"
    settings.write_text(
        "user root\nallow_anonymous true\n"
        f"listener {plain} 127.0.0.1\n"
        f"listener {safe} 127.0.0.1\ncertfile {own}\nkeyfile {key}\n"
    )
    with running([program("mosquitto"), "-c", str(settings)], plain, tmp_path):
        subscriber = Subscriber(plain)
        # WHEN the certificate is not trusted THEN nothing is sent
        sink = open_sink(f"mqtts://localhost:{safe}/car", {})
        with pytest.raises(OSError, match="CERTIFICATE_VERIFY_FAILED"):
            sink.write([code(1)])
        sink.close()
        # WHEN it is trusted THEN the events arrive
        monkeypatch.setenv("SSL_CERT_FILE", str(own))
        sink = open_sink(f"mqtts://localhost:{safe}/car", {})
        sink.write([code(2)])
        sink.close()
        assert wait_for(lambda: ("car/status", "offline") in subscriber.got)
        events = [json.loads(text) for topic, text in subscriber.got if topic == "car/event/code"]
        subscriber.close()
    assert [event["ts"] for event in events] == ["1970-01-01T00:00:00.000Z"]


@dataclass
class Influx2:
    """The write endpoint of InfluxDB 2 as its API says, and as strict.

    Source: InfluxDB 2 API, ``POST /api/v2/write``.
    """

    port: int = 0
    lines: list[str] = field(default_factory=list)

    def answer(self, path: str, headers: Any, body: str) -> tuple[int, str, str]:
        """Return status, code and message."""
        url = urlsplit(path)
        query = {name: values[0] for name, values in parse_qs(url.query).items()}
        if headers["Authorization"] != f"Token {TOKEN}":
            return 401, "unauthorized", "unauthorized access"
        if url.path != "/api/v2/write" or not query.get("org"):
            return 404, "not found", "path or organization not found"
        if query.get("bucket") != BUCKET:
            return 404, "not found", f'bucket "{query.get("bucket")}" not found'
        if query.get("precision", "ns") != "ns":
            return 400, "invalid", "times are in ns"
        bad = [each for each in body.split("\n") if not POINT.fullmatch(each)]
        if bad:
            return 400, "invalid", f"unable to parse '{bad[0]}'"
        self.lines += body.split("\n")
        return 204, "", ""


@contextmanager
def influx2() -> Iterator[Influx2]:
    state = Influx2()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            status, kind, message = state.answer(self.path, self.headers, body)
            said = json.dumps({"code": kind, "message": message}).encode() if kind else b""
            self.send_response(status)
            self.send_header("Content-Length", str(len(said)))
            self.end_headers()
            self.wfile.write(said)

        def log_message(self, *_: Any) -> None:
            """Print nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        state.port = server.server_port
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield state
        finally:
            server.shutdown()
            thread.join()


def test_influxdb_2_takes_the_lines_with_bucket_and_token(monkeypatch: pytest.MonkeyPatch) -> None:
    with influx2() as server:
        address = f"influx+http://127.0.0.1:{server.port}/api/v2/write?org=test&bucket={BUCKET}"
        # GIVEN a server that wants a token WHEN none is given THEN it is said
        monkeypatch.delenv("INFLUX_TOKEN", raising=False)
        sink = open_sink(address, {"vehicle": 'car 17, "blue"'})
        with pytest.raises(OSError, match=r"HTTP 401 .*unauthorized"):
            sink.write([code(1)])
        sink.close()
        # WHEN the token is right THEN all lines are there, on one connection
        monkeypatch.setenv("INFLUX_TOKEN", TOKEN)
        sink = open_sink(address, {"vehicle": 'car 17, "blue"'})
        sink.write([signals(k) for k in range(5)])
        sink.write([code(7)])
        assert len(server.lines) == 6
        assert server.lines[0].startswith('o2mon,vehicle=car\\ 17\\,\\ "blue" Vehicle.OBD.O2WR')
        # AND a line that the server cannot take is refused for good
        with pytest.raises(RefusedError, match=r"HTTP 400 .*unable to parse"):
            sink.write([Record("signals", -1, {"a": 1.0})])
        sink.close()
        lost = open_sink(address.replace(BUCKET, "nothing"), {})
        with pytest.raises(OSError, match=r"HTTP 404 .*not found"):
            lost.write([code(1)])
        lost.close()
