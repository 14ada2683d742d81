"""The MQTT sink against a real broker, mosquitto of Debian, with and without TLS."""

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import can
import pytest

from monitor import cli
from monitor.sinks.address import open_sink
from monitor.sinks.mqtt import Mqtt
from monitor.sinks.outlet import Outlet
from monitor.sinks.record import Record
from tests.helpers.bus.beside import beside, free_port, send_as_driven, until
from tests.helpers.logs.replays import frames_of


def program(name: str) -> str:
    """Return the path of a server's program, or skip the test."""
    found = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if found is None:
        reason = f"{name} is not installed; apt-get install mosquitto"
        if os.environ.get("O2_REQUIRE_SERVERS"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


def accepts(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 0.2).close()
    except OSError:
        return False
    return True


@contextmanager
def running(command: list[str], port: int, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a server until the end of the block; it must accept connections."""
    log = folder / f"{Path(command[0]).name}.out"
    with (
        log.open("ab") as out,
        subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT) as process,
    ):
        try:
            assert until(lambda: accepts(port)), log.read_text()
            yield process
        finally:
            process.kill()


def code(t_ns: int) -> Record:
    values = {"code": "P0133", "fault": "slow, weak", "also": "", "state": "pending", "status": 47}
    return Record("code", t_ns, values)


@contextmanager
def mosquitto(folder: Path, port: int, *lines: str) -> Iterator[None]:
    """Run a broker; ``lines`` are added to its settings."""
    settings = folder / "mosquitto.conf"
    own = [f"listener {port} 127.0.0.1", *(lines or ["allow_anonymous true"])]
    settings.write_text("\n".join(own) + "\n")
    with running([program("mosquitto"), "-c", str(settings)], port, folder):
        yield


class Subscriber:
    """Another client of the broker, which keeps every message."""

    def __init__(self, port: int) -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self.got: list[tuple[str, str]] = []
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = lambda _c, _d, m: self.got.append((m.topic, m.payload.decode()))
        subscribed = threading.Event()
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.connect("127.0.0.1", port)
        self._client.subscribe("#", qos=1)
        self._client.loop_start()
        assert subscribed.wait(5.0)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def outlive_the_broker(folder: Path, port: int, got: list[tuple[str, str]]) -> None:
    """Let an ECU send for two seconds while a broker runs and for two more, then end the run."""
    frames = list(frames_of("healthy_micro_trips", 4.0))
    half_ns = frames[0].t_ns + 2_000_000_000
    try:
        with can.Bus(interface="virtual", channel="sinks") as bus:
            with mosquitto(folder, port):
                subscriber = Subscriber(port)
                send_as_driven(bus, [each for each in frames if each.t_ns < half_ns])
                until(lambda: len(subscriber.got) > 5)
                subscriber.close()
                got += subscriber.got
            send_as_driven(bus, [each for each in frames if each.t_ns >= half_ns])
    finally:
        signal.raise_signal(signal.SIGINT)  # the main thread takes it, and the run ends


def test_a_run_publishes_its_signals_and_survives_the_broker_s_death(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port, result = free_port(), tmp_path / "run.json"
    program("mosquitto")
    got: list[tuple[str, str]] = []
    address = f"mqtt://127.0.0.1:{port}/car"
    run = f"run -i virtual -c sinks --duration 60 --json {result} --sink-rate 5 --sink {address}"
    with beside(lambda _: outlive_the_broker(tmp_path, port, got)):  # four seconds are too few
        assert cli.main([*run.split(), "--sink-tag", "vehicle=17"]) == 3
    assert ("car/status", "online") in got
    signals = [json.loads(text) for topic, text in got if topic == "car/signals"]
    assert 500.0 < signals[-1]["engine_speed_rpm"] < 4000.0
    assert signals[-1]["vehicle"] == "17"
    [sink] = json.loads(result.read_text())["recordings"][0]["sinks"]
    assert sink["sink"] == address
    assert sink["state"] == "lost"
    assert sink["sent"] >= 5
    assert sink["dropped"] >= 1
    assert f"sink {address} takes nothing: " in capsys.readouterr().out


def test_a_broker_that_comes_back_gets_what_waited(tmp_path: Path) -> None:
    port = free_port()
    outlet = Outlet("mqtt", open_sink(f"mqtt://127.0.0.1:{port}", {}))
    outlet.put(code(1))
    assert until(lambda: outlet.state == "lost")
    with mosquitto(tmp_path, port):
        subscriber = Subscriber(port)
        assert until(lambda: outlet.sent == 1)
        assert until(lambda: "o2mon/code" in [topic for topic, _ in subscriber.got])
        outlet.close()
        assert until(lambda: ("o2mon/status", "offline") in subscriber.got)
        subscriber.close()
    assert (outlet.lost, outlet.dropped) == (1, 0)


def test_a_connection_that_was_cut_between_two_records_is_online_again(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port):
        subscriber, sink = Subscriber(port), Mqtt(urlsplit(f"mqtt://127.0.0.1:{port}"), {})
        sink.write([code(1)])
        sink._client.socket().shutdown(socket.SHUT_RDWR)
        states = ["online", "offline", "online"]
        assert until(lambda: [x for topic, x in subscriber.got if "status" in topic] == states)
        sink.close()
        subscriber.close()


def test_a_broker_that_refuses_is_named(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port, "allow_anonymous false"):
        sink = Mqtt(urlsplit(f"mqtt://nobody:wrong@127.0.0.1:{port}"), {})
        with pytest.raises(OSError, match="refuses the connection: Not authorized"):
            sink.write([code(1)])
        sink.close()


def test_a_broker_that_sends_more_than_memory_may_hold_is_cut_off() -> None:
    # GIVEN a server that takes the connection and announces a message of 256 MB
    said = b"\x20\x02\x00\x00" + b"\x30\xff\xff\xff\x7f" + b"x" * 4096
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer(_: threading.Event) -> None:
            taken, _ = server.accept()
            with taken, suppress(ConnectionError):
                taken.recv(4096)
                taken.sendall(said)
                while taken.recv(4096):
                    pass
            ended.set()

        with beside(answer):
            sink = Mqtt(urlsplit(f"mqtt://127.0.0.1:{server.getsockname()[1]}"), {})
            # WHEN something is to be told THEN the connection ends, and is said to have
            with pytest.raises(OSError, match=r"connection is lost|no confirmation"):
                for i in range(3):
                    sink.write([code(i)])
            assert ended.wait(2.0)
        sink.close()


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
        assert until(lambda: ("car/status", "offline") in subscriber.got)
        events = [json.loads(text) for topic, text in subscriber.got if topic == "car/code"]
        subscriber.close()
    assert [event["t_ns"] for event in events] == [2]
