"""The sinks against the real servers: mosquitto, influxd and prometheus of Debian."""

import json
import signal
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote, urlsplit
from urllib.request import urlopen

import can
import pytest

from monitor import cli
from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of
from monitor.sinks.address import open_sink
from monitor.sinks.line_protocol import HttpLines
from monitor.sinks.mqtt import Mqtt
from monitor.sinks.outlet import Outlet
from monitor.sinks.prometheus import Scraped
from monitor.sinks.record import Record, RefusedError
from tests.helpers.live_player import frames_of
from tests.helpers.servers import free_port, program, running, wait_for

PASSED = Record("verdict", 3, {"of": "window", "verdict": "passed", "fault": ""})
VERDICT = Record("verdict", 5, {"of": "window", "verdict": "failed", "fault": "slow"})
LAMBDA = "Vehicle.OBD.O2WR.Sensor1.Lambda"


def signals(t_ns: int, value: float = 0.998) -> Record:
    return Record("signals", t_ns, {LAMBDA: value, "Vehicle.O2Monitor.IsEnabled": True})


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


def send_as_driven(bus: can.BusABC, frames: Iterable[Frame]) -> None:
    """Send frames at the pace of their times, the first one at once."""
    begin_s, first_ns = time.monotonic(), None
    for frame in frames:
        first_ns = frame.t_ns if first_ns is None else first_ns
        time.sleep(max(0.0, begin_s + (frame.t_ns - first_ns) / 1e9 - time.monotonic()))
        bus.send(message_of(frame._replace(t_ns=time.time_ns())))


def outlive_the_broker(folder: Path, port: int, got: list[tuple[str, str]]) -> None:
    """Let an ECU send for two seconds while a broker runs and for two more, then end the run."""
    frames = list(frames_of("healthy_micro_trips", 4.0))
    half_ns = frames[0].t_ns + 2_000_000_000
    try:
        with can.Bus(interface="virtual", channel="sinks") as bus:
            with mosquitto(folder, port):
                subscriber = Subscriber(port)
                send_as_driven(bus, [each for each in frames if each.t_ns < half_ns])
                wait_for(lambda: len(subscriber.got) > 50)
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
    ecu = threading.Thread(target=outlive_the_broker, args=[tmp_path, port, got])
    address = f"mqtt://127.0.0.1:{port}/car"
    run = f"run -i virtual -c sinks --duration 60 --json {result} --sink-rate 5 --sink {address}"
    ecu.start()
    assert cli.main([*run.split(), "--sink-tag", "vehicle=17"]) == 3  # four seconds are too few
    ecu.join()
    assert ("car/status", "online") in got
    speeds = [text for topic, text in got if topic == "car/Vehicle/OBD/EngineSpeed"]
    point = json.loads(speeds[-1])
    assert point["path"] == "Vehicle.OBD.EngineSpeed"
    assert 500.0 < float(point["dp"]["value"]) < 4000.0
    assert point["tags"] == {"vehicle": "17"}
    [sink] = json.loads(result.read_text())["recordings"][0]["sinks"]
    assert sink["sink"] == address
    assert sink["state"] == "lost"
    assert sink["sent"] >= 5
    assert sink["dropped"] >= 1
    assert f"sink {address} takes nothing: " in capsys.readouterr().out


def test_a_broker_that_comes_back_gets_what_waited(tmp_path: Path) -> None:
    port = free_port()
    outlet = Outlet("mqtt", open_sink(f"mqtt://127.0.0.1:{port}", {}), again_s=0.1, flush_s=0.02)
    outlet.put(code(1))
    assert wait_for(lambda: outlet.state == "lost")
    with mosquitto(tmp_path, port):
        subscriber = Subscriber(port)
        assert wait_for(lambda: outlet.sent == 1)
        assert wait_for(lambda: "o2mon/event/code" in [topic for topic, _ in subscriber.got])
        outlet.close()
        assert wait_for(lambda: ("o2mon/status", "offline") in subscriber.got)
        subscriber.close()
    assert (outlet.lost, outlet.dropped) == (1, 0)


def test_a_broker_that_refuses_is_named(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path, port, "allow_anonymous false"):
        sink = Mqtt(urlsplit(f"mqtt://nobody:wrong@127.0.0.1:{port}"), {})
        with pytest.raises(OSError, match="refuses the connection: Not authorized"):
            sink.write([code(1)])
        sink.close()


INFLUX = """
reporting-disabled = true
bind-address = "127.0.0.1:{rpc}"
[meta]
  dir = "{folder}/meta"
[data]
  dir = "{folder}/data"
  wal-dir = "{folder}/wal"
[monitor]
  store-enabled = false
[http]
  bind-address = "127.0.0.1:{http}"
  log-enabled = false
[[udp]]
  enabled = true
  bind-address = "127.0.0.1:{udp}"
  database = "o2mon"
  batch-timeout = "50ms"
"""


def test_influxdb_takes_the_lines_and_gives_the_values_back(tmp_path: Path) -> None:
    ports = {name: free_port() for name in ("rpc", "http", "udp")}
    (tmp_path / "influx.conf").write_text(INFLUX.format(folder=tmp_path, **ports))
    base = f"http://127.0.0.1:{ports['http']}"

    def ask(query: str) -> list[Any]:
        with urlopen(f"{base}/query?db=o2mon&epoch=ns&q={quote(query)}", b"", 5.0) as answer:
            results = json.load(answer)["results"][0]
        return [(each.get("tags"), each["values"]) for each in results.get("series", [])]

    command = [program("influxd"), "-config", str(tmp_path / "influx.conf")]
    with running(command, ports["http"], tmp_path):
        ask("CREATE DATABASE o2mon")
        tags = {"vehicle": 'car 17, "blue"'}
        sink = HttpLines(urlsplit(f"influx+{base}"), tags)
        sink.write([signals(k * 1_000_000_000, 1.0 + k / 64) for k in range(200)])
        sink.write([code(5), VERDICT])
        [(_, values)] = ask(f'SELECT "{LAMBDA}", "Vehicle.O2Monitor.IsEnabled" FROM o2mon')
        assert values == [[k * 1_000_000_000, 1.0 + k / 64, True] for k in range(200)]
        [(found, values)] = ask(
            "SELECT fault, status FROM o2mon_event WHERE code='P0133' GROUP BY *"
        )
        assert found == {"code": "P0133", "kind": "code", "of": "", **tags}
        assert values == [[5, "slow, weak", 47]]
        with pytest.raises(RefusedError, match=r"HTTP 400 .*conflict"):
            sink.write([Record("signals", 9, {LAMBDA: "a text now"})])
        sink.close()
        udp = open_sink(f"influx+udp://127.0.0.1:{ports['udp']}", {"vehicle": "udp"})
        udp.write([signals(7)])
        udp.close()
        count = "SELECT count(*) FROM o2mon WHERE vehicle='udp'"
        assert wait_for(lambda: bool(ask(count)))
        lost = HttpLines(urlsplit(f"influx+{base}/write?db=nothing"), {})
        with pytest.raises(OSError, match=r"HTTP 404 .*not found"):
            lost.write([signals(1)])
        lost.close()


def test_prometheus_scrapes_the_metrics(tmp_path: Path) -> None:
    sink = Scraped(urlsplit("prometheus://127.0.0.1:0"), {"vehicle": 'car "17"'})
    sink.write(
        [
            signals(1),
            code(2),
            PASSED,
        ]
    )
    port, settings = free_port(), tmp_path / "prometheus.yml"
    settings.write_text(
        "global: {scrape_interval: 200ms, scrape_timeout: 200ms}\n"
        "scrape_configs:\n"
        f"- {{job_name: o2mon, static_configs: [{{targets: ['127.0.0.1:{sink.port}']}}]}}\n"
    )
    command = [
        program("prometheus"),
        f"--config.file={settings}",
        f"--storage.tsdb.path={tmp_path / 'tsdb'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]

    def ask(query: str) -> list[dict[str, Any]]:
        url = f"http://127.0.0.1:{port}/api/v1/query?query={quote(query)}"
        try:
            with urlopen(url, timeout=5.0) as answer:
                return list(json.load(answer)["data"]["result"])
        except HTTPError as error:  # it listens before it is ready
            error.close()
            return []

    with running(command, port, tmp_path):
        name = "Vehicle_OBD_O2WR_Sensor1_Lambda"
        assert wait_for(lambda: bool(ask(name)))
        [found] = ask(name)
        assert found["metric"]["vehicle"] == 'car "17"'
        assert float(found["value"][1]) == 0.998
        assert wait_for(lambda: bool(ask("up")))
        [found] = ask('o2mon_code_status{state="pending"}')
        assert (found["metric"]["code"], found["metric"]["fault"]) == ("P0133", "slow, weak")
        assert [float(f["value"][1]) for f in ask('o2mon_verdict{verdict="passed"}')] == [1.0]
        assert [float(f["value"][1]) for f in ask("up")] == [1.0]
    sink.close()


def test_a_port_without_a_broker_is_refused_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    sink = Mqtt(urlsplit(f"mqtt://127.0.0.1:{port}"), {})
    with pytest.raises(OSError, match="refused"):
        sink.write([code(1)])
    sink.close()
