"""``o2mon run --live``: the loop, the page and the command line together."""

import json
import re
import socket
import threading
import time
from typing import Any

import can
import httpx
import pytest

from monitor import cli
from tests.helpers.bus.beside import beside, free_port, send_as_driven, until
from tests.helpers.logs.replays import frames_of

CHANNEL = "live-page"


def drive(_: threading.Event) -> None:
    """Let an ECU send what it sent in a recorded drive, at its pace, to a run that listens."""
    frames = frames_of("healthy_micro_trips", 4.0)
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        assert until(lambda: len(can.interfaces.virtual.channels[CHANNEL]) > 1, 60.0)
        send_as_driven(bus, frames)


def watch(url: str, seconds: float, into: list[dict[str, Any]]) -> None:
    """Collect what a browser is sent from when the page can be had."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        try:
            with httpx.stream("GET", url + "events", timeout=5.0) as answer:
                lines = (line for line in answer.iter_lines() if line.startswith("data: {"))
                into.extend(json.loads(line.removeprefix("data: ")) for line in lines)
                return
        except httpx.ConnectError:
            time.sleep(0.05)


def test_a_run_shows_its_page_while_it_judges(capsys: pytest.CaptureFixture[str]) -> None:
    seen, port = list[dict[str, Any]](), free_port()
    url = f"http://127.0.0.1:{port}/"
    run = ["run", "-i", "virtual", "-c", CHANNEL, "--live", str(port), "--duration", "4"]
    with beside(lambda _: watch(url, 10.0, seen)), beside(drive):
        assert cli.main(run) == 3
    assert f"live page: {url}" in capsys.readouterr().out
    last = [message for message in seen if message][-1]
    greeting = next(message for message in seen if "channel" in message)  # a browser may be earlier
    assert greeting["channel"] == f"virtual {CHANNEL}"
    assert greeting["limits"]["j_mu"] > 0.0
    samples = [s for message in seen for s in message.get("samples", ())]
    assert len({ms for ms, *_ in samples}) == len(samples) >= 20  # none twice
    assert last["now"]["samples"] >= len(samples)
    health = [message["health"] for message in seen if "health" in message]
    assert health[-1]["frames"] > 400
    assert health[-1]["state"] == "active"
    assert health[-1]["page_dropped"] == 0
    assert (health[-1]["sinks_dropped"], health[-1]["sinks_off"]) == (0, [])
    with pytest.raises(httpx.ConnectError):
        httpx.get(url)


def test_a_taken_port_or_a_false_host_ends_the_command(capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        here = f"127.0.0.1:{taken.getsockname()[1]}"
        for where, why in ((here, "Address already in use"), (f"{'a' * 70}:80", "encod")):
            assert cli.main(["run", "-i", "virtual", "-c", CHANNEL, "--live", where]) == 2
            said = "".join(capfd.readouterr())
            assert re.fullmatch(rf"o2mon: --live {where}: .*{why}.*\n", said)


def test_a_page_that_others_can_reach_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    run = ["run", "-i", "virtual", "-c", CHANNEL, "--duration", "0.3", "--live", f"0.0.0.0:{port}"]
    assert cli.main(run) == 3
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"live page: http://127.0.0.1:{port}/"
    assert lines[1] == "warning: everyone who reaches 0.0.0.0 can read the live page"
