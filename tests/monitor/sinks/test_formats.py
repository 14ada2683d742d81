"""Line protocol, text of Prometheus and messages of MQTT, without a server."""

import json
import re
import socket
from collections.abc import Mapping
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import UsageError
from monitor.sinks import vss
from monitor.sinks.address import open_sink, shown
from monitor.sinks.line_protocol import DATAGRAM, UdpLines, datagrams, line
from monitor.sinks.mqtt import messages
from monitor.sinks.prometheus import Page, Scraped
from monitor.sinks.record import Record, Value
from tests.conftest import ROOT

LAMBDA = "Vehicle.OBD.O2WR.Sensor1.Lambda"
SIGNALS = Record(
    "signals",
    1_700_000_000_500_000_000,
    {LAMBDA: 0.998, "Vehicle.O2Monitor.IsEnabled": True, "Vehicle.O2Monitor.WaitsFor": ""},
)
CODE = Record(
    "code", 7, {"code": "P0133", "fault": "slow", "also": "", "state": "pending", "status": 47}
)
VERDICT = Record("verdict", 8, {"of": "window", "verdict": "failed", "fault": "slow"})


def test_signals_are_one_line_under_their_paths() -> None:
    assert line(SIGNALS, {"vehicle": "17"}) == (
        f"o2mon,vehicle=17 {LAMBDA}=0.998,Vehicle.O2Monitor.IsEnabled=true,"
        'Vehicle.O2Monitor.WaitsFor="" 1700000000500000000'
    )


names = st.text("abc ,=\\", min_size=1, max_size=8).map(lambda name: name.replace("\\", "/"))
texts = st.text('abc ,="\\', max_size=8)


@given(
    tags=st.dictionaries(names, names, max_size=3),
    values=st.dictionaries(names, st.floats(-1e9, 1e9) | st.booleans() | texts, min_size=1),
)
def test_any_text_stays_inside_its_place_of_the_line(
    tags: Mapping[str, str], values: Mapping[str, Value]
) -> None:
    # an unescaped space parts the three places of a line, unescaped commas what is in them
    written = line(Record("signals", 5, values), tags)
    outside_text = re.sub(r'"(?:[^"\\]|\\.)*"', '""', written)
    places = re.split(r"(?<!\\) ", outside_text)
    assert len(places) == 3
    assert places[2] == "5"
    assert len(re.split(r"(?<!\\),", places[0])) == 1 + len(tags)
    assert len(re.split(r"(?<!\\),", places[1])) == len(values)


def test_datagrams_hold_whole_lines_below_the_size_of_a_packet() -> None:
    lines = [line(SIGNALS, {})] * 50
    made = datagrams(lines)
    assert b"".join(made).decode().splitlines() == lines
    assert 1 < len(made) < 10
    assert all(len(each) <= DATAGRAM for each in made)


def test_lines_travel_by_udp() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(2.0)
        sink = UdpLines(urlsplit(f"influx+udp://127.0.0.1:{server.getsockname()[1]}"), {})
        sink.write([SIGNALS, CODE])
        sink.close()
        assert server.recv(2000).decode().splitlines() == [line(SIGNALS, {}), line(CODE, {})]


def test_metrics_are_named_after_the_paths_and_events_are_counted() -> None:
    page = Page({"vehicle": 'car "A"'})
    for each in (
        SIGNALS,
        CODE,
        CODE,
        VERDICT,
    ):
        page.take(each)
    lines = page.text().splitlines()
    own = r'vehicle="car \"A\""'
    assert f"Vehicle_OBD_O2WR_Sensor1_Lambda{{{own}}} 0.998" in lines
    assert f"Vehicle_O2Monitor_IsEnabled{{{own}}} 1" in lines
    assert f'Vehicle_O2Monitor_WaitsFor{{{own},value="nothing"}} 1' in lines
    assert f'o2mon_events_total{{{own},kind="code"}} 2' in lines
    assert f'o2mon_code_status{{{own},code="P0133",fault="slow",state="pending"}} 47' in lines
    assert f'o2mon_verdict{{{own},verdict="failed",fault="slow"}} 1' in lines
    assert f'o2mon_verdict{{{own},verdict="passed"}} 0' in lines


def test_the_page_of_metrics_is_served_until_the_run_ends() -> None:
    sink = Scraped(urlsplit("prometheus://127.0.0.1:0"), {})
    sink.write([SIGNALS])
    with urlopen(f"http://127.0.0.1:{sink.port}/metrics", timeout=2.0) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
        assert "Vehicle_OBD_O2WR_Sensor1_Lambda 0.998" in answer.read().decode()
    with pytest.raises(UsageError, match="Address already in use"):
        Scraped(urlsplit(f"prometheus://127.0.0.1:{sink.port}"), {})
    sink.close()
    with pytest.raises(OSError, match="refused"):
        urlopen(f"http://127.0.0.1:{sink.port}/metrics", timeout=2.0)


def test_messages_of_mqtt_are_data_points_with_path_value_and_time() -> None:
    topics = dict(messages(SIGNALS, {"vehicle": "17"}))
    assert json.loads(topics["Vehicle/OBD/O2WR/Sensor1/Lambda"]) == {
        "path": LAMBDA,
        "dp": {"value": "0.998", "ts": "2023-11-14T22:13:20.500Z"},
        "tags": {"vehicle": "17"},
    }
    assert json.loads(topics["Vehicle/O2Monitor/IsEnabled"])["dp"]["value"] == "true"
    [(topic, text)] = messages(CODE, {})
    assert topic == "event/code"
    assert json.loads(text)["code"] == "P0133"


def test_an_address_without_a_sink_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match=r"--sink kafka://b/t: no such kind; there are influx\+"):
        open_sink("kafka://user:secret@b/t", {})
    with pytest.raises(UsageError, match="--sink mqtt:/x: an MQTT sink needs a host"):
        open_sink("mqtt:/x", {})
    with pytest.raises(UsageError, match=r"prometheus\+file:FILE"):
        open_sink("prometheus+file://host/a.prom", {})
    with pytest.raises(UsageError, match="Port"):
        open_sink("mqtt://host:many", {})


def test_no_message_shows_a_password() -> None:
    seen = shown("influx+http://user:secret@host:8086/write?p=secret&db=x")
    assert seen == "influx+http://host:8086/write"


def test_the_dashboard_asks_only_for_metrics_that_a_run_has() -> None:
    text = (ROOT / "examples/grafana_dashboard.json").read_text()
    asked = set(re.findall(r"\b(?:Vehicle|o2mon)_\w+", text))
    paths = {path for path, _ in vss.SIGNALS.values()}
    paths |= {value for name, value in vars(vss).items() if name.isupper() and name != "SIGNALS"}
    page = Page({})
    page.take(Record("signals", 1, dict.fromkeys(sorted(paths), 1.0)))
    page.take(CODE)
    page.take(VERDICT)
    had = set(re.findall(r"^# TYPE (\w+) ", page.text(), re.MULTILINE))
    assert len(asked) > 8
    assert asked <= had
