"""The live page's feed and its server's process: what they show, bear and survive."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import httpx
import numpy as np
import pytest

from monitor.base.types import Frame, Quality, Sample
from monitor.bus.live import feed as feeds
from monitor.bus.live.codes import fault_memory
from monitor.bus.live.describe import ConditionWords, signal_rows
from monitor.judge.enable import CONDITIONS
from monitor.judge.findings import DtcChanged
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.events import CycleStarted, Tick
from tests.conftest import ROOT
from tests.helpers.bus.beside import until
from tests.helpers.bus.live_player import Player, Sink


@pytest.fixture
def player() -> Iterator[Player]:
    with Player() as playing:
        yield playing


@pytest.fixture
def fed() -> Player:
    return Player(server=Sink())


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_drive_is_told_in_four_messages_a_second(fed: Player, late_sensor: list[Frame]) -> None:
    fed.health["stale"] = ("rail_pressure_mpa",)
    fed.push(late_sensor)
    fed.feed.work(math.inf)
    first, *rest = fed.server.messages
    assert [c["name"] for c in first["conditions"]] == list(CONDITIONS)
    assert first["channel"] == "vcan0"
    assert 50 * 4 * 0.9 < len(fed.server.lines) < 50 * 4 * 1.1
    samples = [s for m in fed.server.messages for s in m["samples"]]
    assert abs(len(samples) - fed.pipeline.monitor.samples) <= 1
    times = [t for t, *_ in samples]
    assert times == sorted(times)
    assert times[1] - times[0] == pytest.approx(100.0)
    windows = [w for m in fed.server.messages for w in m["windows"]]
    assert [w["index"] for w in windows] == list(range(len(windows)))
    assert len(windows) >= 4
    assert {"lag_rich_to_lean_s", "dead_time_rich_to_lean_s", "gain", "offset"} <= set(
        windows[-1]["statistics"]
    )
    (code,) = rest[-1]["memory"]["codes"]
    assert code["code"] == "P015A"
    assert code["meaning"] == "late on rich-to-lean edges"
    assert "test failed" in code["bits"]
    assert ["vehicle speed", "km/h"] in [[n, v.split()[-1]] for n, v in code["frame"]["values"]]
    told = dict(rest[-1]["memory"]["evidence"])
    assert told.pop("delay_rich_to_lean") == "found"
    assert set(told.values()) <= {"excluded", "–"}  # a drive with its answer needs no more time
    assert abs(rest[-1]["vehicle_offset"] or 0.0) <= fed.setup.limits.offset_high
    named = {"absent": [], "stale": ["rail pressure"]}
    assert rest[-1]["health"] == {**fed.health, **named, "page_dropped": 0}
    # WHEN the codes are cleared THEN that is shown at once
    t_ns = late_sensor[-1].t_ns
    for dtc in fed.store.clear():
        fed.feed.push(DtcChanged(t_ns, dtc))
    fed.feed.close()
    memory = fed.server.messages[-1]["memory"]
    assert (memory["codes"], memory["fault_flag"], fed.server.is_closed) == ([], False, True)


def test_a_confirmed_code_its_lamp_and_its_healing_are_shown() -> None:
    store, seen = DtcStore(), []
    # GIVEN a fault in two driving cycles, then four in which the test passes
    for failed in (True, True, False, False, False, False):
        store.start_driving_cycle()
        if failed:
            store.fail("delay_symmetric", 5, ("slow_symmetric",))
        else:
            store.complete("response")
        seen.append(fault_memory(store))
    pending, confirmed, *_, healed = seen
    assert [code["state"] for code in pending["codes"]] == ["pending", "pending"]
    assert pending["permanent"] == []
    assert not pending["mil"]
    first = confirmed["codes"][0]
    assert (first["code"], first["state"], first["t_ns"]) == ("P015A", "confirmed", "5")
    assert first["meaning"] == "late on both edges, or slow on both edges"
    assert "warning indicator" in first["bits"]
    assert confirmed["permanent"] == ["P015A", "P015B"]
    assert confirmed["mil"]
    assert not healed["mil"]
    assert "warning indicator" not in healed["codes"][0]["bits"]
    tests = {test["test"]: test["complete"] for test in healed["tests"]}
    assert tests["response"]
    assert not tests["range"]


def test_the_limits_are_those_of_the_driving_cycle(fed: Player) -> None:
    monitor = fed.pipeline.monitor
    # WHEN the reference of the vehicle has learned and the next one begins THEN the page is told
    fed.feed.work(0.0)
    monitor.adopt(replace(monitor.limits, offset_high=0.03))
    fed.feed.push(CycleStarted(5, None))
    fed.feed.work(1.0)
    fed.feed.work(2.0)
    highs = [message.get("limits", {}).get("offset_high") for message in fed.server.messages]
    assert highs == [fed.setup.limits.offset_high, 0.03, None]


def test_a_condition_says_what_it_sees(fed: Player, late_sensor: list[Frame]) -> None:
    # GIVEN an engine whose air mass message falls silent
    silent = {f.can_id for f in late_sensor[:1]}
    begin_ns = late_sensor[0].t_ns
    fed.push([f for f in late_sensor[:8000] if f.can_id not in silent or f.t_ns < begin_ns + 30e9])
    now = fed.server.messages[-1]["now"]
    held, seen = (dict(zip(CONDITIONS, now[key], strict=True)) for key in ("held", "seen"))
    # THEN the conditions name what is missing, and the others what they see
    assert not held["inputs_valid"]
    assert "not received" in seen["inputs_valid"]
    assert seen["engine_speed"].endswith(" rpm")
    assert seen["coolant_warm"].endswith(" °C")
    assert seen["closed_loop"] in ("closed", "open loop", "changing")
    assert now["predicted"] is None
    assert any(why for _, _, why in now["signals"])


@pytest.mark.parametrize("quality", set(Quality) - {Quality.GOOD})
def test_a_value_that_is_missing_says_why(quality: Quality) -> None:
    sample = Sample(0, 0, np.array([math.nan]), np.array([quality], dtype=np.uint8))
    ((_, value, why),) = signal_rows(["maf_kg_h"], sample)
    assert value == "–"
    assert why


def test_an_input_outside_the_training_is_named_with_its_bound(
    fed: Player, late_sensor: list[Frame]
) -> None:
    monitor, setup = fed.pipeline.monitor, fed.setup
    ticks = [e for e in fed.judged(late_sensor[:2000]) if isinstance(e, Tick)]
    conditions = ConditionWords(monitor, setup.config.enable, setup.model.card)
    place, rail = CONDITIONS.index("trained_range"), monitor.names.index("rail_pressure_mpa")
    tick = ticks[-1]
    assert conditions.seen(tick)[place] == "within"
    values = tick.sample.values.copy()
    values[rail] = 39.0
    outside = tick._replace(sample=tick.sample._replace(values=values))
    assert re.fullmatch(r"rail pressure 39\.0 MPa, above \d+\.\d+", conditions.seen(outside)[place])


def test_fast_samples_are_thinned_out_to_ten_a_second(
    fed: Player, late_sensor: list[Frame]
) -> None:
    ticks = [e for e in fed.judged(late_sensor[:4000]) if isinstance(e, Tick)]
    # GIVEN a model with samples every 30 ms
    card = replace(fed.setup.model.card, period_ns=30_000_000)
    fed.setup.model.card = card
    feed = feeds.LiveFeed(
        fed.server, fed.pipeline.monitor, fed.setup, health=dict, channel="", say=print
    )
    for tick in ticks:
        feed.push(tick)
    feed.work(0.0)
    times = [ms for ms, *_ in fed.server.messages[-1]["samples"]]
    assert len(times) > 40
    assert {round(b - a) for a, b in pairwise(times)} == {4 * 100}


def test_a_server_that_takes_nothing_costs_samples_not_memory(
    late_sensor: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "SAMPLES", 100)
    fed = Player(server=Sink())
    fed.server.is_free = False
    fed.push(late_sensor[:4000])
    assert not fed.server.lines
    fed.server.is_free = True
    fed.feed.work(1e12)
    (message,) = fed.server.messages
    samples = fed.pipeline.monitor.samples
    assert len(message["samples"]) == 100
    assert message["health"]["page_dropped"] == samples - 100
    assert message["samples"][-1][0] == pytest.approx((samples - 1) * 100.0)


def test_a_hanging_server_never_delays_the_loop(player: Player, late_sensor: list[Frame]) -> None:
    assert until(lambda: httpx.get(player.url).status_code == 200)
    os.kill(player.server.pid, signal.SIGSTOP)
    try:
        slowest_s, t_s = 0.0, 0.0
        player.push(late_sensor[:4000])
        # WHEN far more than a pipe holds is due
        for _ in range(2000):
            t_s += 1e6
            begin_s = time.perf_counter()
            player.feed.work(t_s)
            slowest_s = max(slowest_s, time.perf_counter() - begin_s)
    finally:
        os.kill(player.server.pid, signal.SIGCONT)
    # THEN no call has waited, and the page goes on when the server does
    assert slowest_s < 0.1  # the machine may be busy; a wait would be for ever
    player.feed.due_s = -1e9
    player.work(1.0)
    with httpx.stream("GET", player.url + "events", timeout=5.0) as answer:
        first = next(line for line in answer.iter_lines() if line.startswith("data: "))
    assert json.loads(first.removeprefix("data: "))["channel"] == "vcan0"
    assert not player.lines


def test_the_loop_outlives_the_server_and_says_so(player: Player, late_sensor: list[Frame]) -> None:
    player.push(late_sensor[:2000])
    os.kill(player.server.pid, signal.SIGKILL)
    assert until(lambda: not is_running(player.server.pid))
    before = player.pipeline.monitor.samples
    player.push(late_sensor[2000:6000])
    assert player.pipeline.monitor.samples > before + 150
    assert len(player.lines) == 1
    assert "judging goes on without the page" in player.lines[0]
    assert player.feed.due_s == float("inf")


def test_the_server_ends_with_the_loop() -> None:
    script = (
        "import time; from tests.helpers.bus.live_player import Player; p = Player();"
        "print(p.server.pid, flush=True); p.work(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as loop:
        assert loop.stdout is not None
        pid = int(loop.stdout.readline())
        assert is_running(pid)
        loop.kill()
    assert until(lambda: not is_running(pid))


def test_closing_ends_the_server_though_browsers_watch(late_sensor: list[Frame]) -> None:
    ended = []

    def watch(url: str) -> None:
        with httpx.stream("GET", url + "events", timeout=10.0) as answer:
            ended.extend(line for line in answer.iter_lines() if line == "event: ended")

    with Player() as player:
        player.push(late_sensor[:2000])
        watcher = threading.Thread(target=watch, args=[player.url])
        watcher.start()
        player.work(1.0)
        begin_s = time.monotonic()
    assert time.monotonic() - begin_s < 2.0
    watcher.join(5.0)
    assert ended == ["event: ended"]
    assert not is_running(player.server.pid)
