"""The live page in a real browser: Debian's chromium, headless."""

import os
import re
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from monitor.base.types import Frame
from monitor.bus.live.process import Server
from monitor.memory.dtc_store import DtcStore
from tests.helpers.bus.beside import beside, until
from tests.helpers.bus.live_player import Player
from tests.helpers.logs.replays import frames_of

LAPTOP, PHONE = (1366, 768), (390, 844)


@pytest.fixture(scope="module")
def late_sensor() -> list[Frame]:
    return frames_of("delay_rich_to_lean", 240)


@pytest.fixture(scope="module")
def drive(late_sensor: list[Frame]) -> Iterator[Player]:
    """Give a drive whose first part is over, and a server that knows it."""
    with Player() as player:
        player.push(late_sensor, 150)
        player.work(0.6)
        yield player


@contextmanager
def at_work(player: Player, frames: Sequence[Frame] = ()) -> Iterator[None]:
    """Let the feed go on while the browser is asked, with frames at four times their pace."""

    def work(over: threading.Event) -> None:
        player.feed.due_s = -1e9
        parts = (frames[k : k + 400] for k in range(0, len(frames), 400))  # half a second each
        while not over.is_set():
            if part := next(parts, None):
                player.push(part, 4)
            else:
                player.work(0.1)

    with beside(work):
        yield


@contextmanager
def opened(
    browser: Browser, url: str, size: tuple[int, int] = LAPTOP, scheme: Any = "light"
) -> Iterator[Page]:
    """Open the page; whatever it complains of or asks others for fails the test."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme
    )
    page = context.new_page()
    bad: list[str] = []
    page.on("console", lambda message: bad.append(f"console: {message.type} {message.text}"))
    page.on("pageerror", lambda error: bad.append(f"error: {error}"))
    page.on(
        "request", lambda r: None if r.url.startswith(url) else bad.append(f"asked for {r.url}")
    )
    page.add_init_script(
        "addEventListener('securitypolicyviolation', e => console.error(e.violatedDirective))"
    )
    page.goto(url)
    try:
        yield page
    finally:
        context.close()
    assert bad == []


def text(page: Page, selector: str) -> str:
    return page.locator(selector).inner_text()


def test_a_browser_that_comes_late_sees_the_drive(browser: Browser, drive: Player) -> None:
    with at_work(drive), opened(browser, drive.url) as page:
        page.wait_for_selector("#verdict.failed")
        assert text(page, "#verdict-words") == "Fault: P015A"
        assert text(page, "#verdict-more") == "Late on rich-to-lean edges."
        sure = r"Confidence: for delay_rich_to_lean stands \d\.\d times the evidence"
        assert re.match(sure, text(page, "#verdict-sure"))
        assert "Next: look for a leak" in text(page, ".dtc.pending")
        assert text(page, "#connection") == "live"
        assert "vcan0" in text(page, "#where")
        assert page.title().startswith("✕ P015A")
        tiles = text(page, "#tiles")
        assert re.search(r"Measured\s+\d+\.\d{4}", tiles)
        counts = re.search(r"Windows\s+(\d+)\s+✓ (\d+)\s+✕ (\d+)\s+\? (\d+)", tiles)
        assert counts and int(counts[1]) == sum(int(counts[i]) for i in (2, 3, 4)) > 15
        assert re.search(r"Predicted\s+\d+\.\d{4}", tiles)
        assert re.search(r"Residual\s+[+−]\d+\.\d{4}", tiles)
        # the plots have drawn the drive, not only their axes
        assert page.locator("#plots canvas").count() == 4
        for i, wanted in enumerate([r"predicted\s*\d", "residual", "mean", "std"]):
            assert re.search(wanted, page.locator("#plots figure").nth(i).inner_text())
        colours = page.evaluate(
            "() => { const c = document.querySelector('#plots canvas');"
            "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "const s = {}; for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 200) {"
            "const k = d.slice(i, i + 3).join(); s[k] = (s[k] || 0) + 1; } return s; }"
        )
        assert colours.get("11,98,176", 0) > 300  # measured
        assert colours.get("209,122,0", 0) > 300  # predicted


@pytest.mark.parametrize("size", [LAPTOP, PHONE])
def test_what_is_missing_is_named_in_full(
    browser: Browser, late_sensor: list[Frame], size: tuple[int, int]
) -> None:
    # GIVEN an engine whose first message falls silent after ten seconds
    silent, first_ns = late_sensor[0].can_id, late_sensor[0].t_ns
    part = [f for f in late_sensor[:6000] if f.can_id != silent or f.t_ns < first_ns + 10e9]
    with Player() as player:
        player.push(part, 60)
        with at_work(player), opened(browser, player.url, size) as page:
            page.wait_for_selector("#conditions li.blocks")
            row = page.locator("#conditions li").first
            assert "air mass not received, maf not received" in row.inner_text()
            assert "air mass not received" in text(page, "#tiles > div:nth-child(4)")
            assert text(page, "#signals .bad >> nth=0").startswith("air mass\nnot received")
            for place in ("#conditions .what", "#conditions .seen"):
                boxes = page.locator(place).evaluate_all(
                    "es => es.map(e => [e.clientWidth, e.scrollWidth])"
                )
                assert all(inside > 30 and needed <= inside for inside, needed in boxes), place


def test_codes_are_shown_with_status_and_freeze_frame(browser: Browser, drive: Player) -> None:
    with at_work(drive), opened(browser, drive.url) as page:
        card = page.locator("#codes .dtc.pending")
        card.wait_for()
        assert "P015A" in card.inner_text()
        assert "test failed" in card.inner_text()
        assert not card.locator(".pairs").is_visible()
        # WHEN opened from the keyboard
        card.locator("summary").focus()
        page.keyboard.press("Enter")
        assert re.search(r"vehicle speed\s+[\d.]+ km/h", card.locator(".pairs").inner_text())


def test_windows_response_health_and_memory_are_shown(browser: Browser, drive: Player) -> None:
    drive.health["error_frames"] = 3
    with at_work(drive), opened(browser, drive.url) as page:
        page.wait_for_selector("#windows tbody td:nth-child(5)")
        rows = page.locator("#windows tbody tr")
        assert rows.count() == 12
        assert re.search(r"[+−]0\.\d{4}\s+0\.\d{4}\s+✕ failed", rows.first.inner_text())
        late = page.locator(".gauge", has_text="Dead time to lean")
        assert "beyond" in (late.get_attribute("class") or "")
        assert re.search(r"≤ 0.25 s\s+✕ 0\.\d\d s", late.inner_text())
        assert "sound is ≤ 0.25 s" in (late.locator("svg").get_attribute("aria-label") or "")
        page.wait_for_selector("#health .bad")
        bad = page.locator("#health .bad", has_text="error frames")  # a busy machine may be late
        assert re.search(r"error frames\s+3", bad.inner_text())
        assert re.search(r"response\s+✓ complete\s+1 / 0", text(page, "#memory"))
        assert re.search(r"ignition cycles\s+\d", text(page, "#memory"))
        assert re.search(r"rail pressure\s+[\d.]+ MPa", text(page, "#signals"))


def test_a_bus_that_is_gone_is_said_at_the_top(browser: Browser, drive: Player) -> None:
    with at_work(drive), opened(browser, drive.url) as page:
        page.wait_for_selector("#connection.live")
        assert not page.locator("#bus").is_visible()
        drive.health["state"] = "gone"
        try:
            page.wait_for_selector("#bus:visible")
            assert text(page, "#bus") == "bus gone"
            assert re.search(r"state\s+gone", text(page, "#health"))
        finally:
            drive.health["state"] = "active"
        page.wait_for_selector("#bus", state="hidden")


def test_values_move_with_the_drive_and_hold_still_on_request(
    browser: Browser, drive: Player, late_sensor: list[Frame]
) -> None:
    later = [frame._replace(t_ns=frame.t_ns + 240_000_000_000) for frame in late_sensor]
    with at_work(drive, later), opened(browser, drive.url) as page:
        page.wait_for_selector("#plots canvas")

        def newest() -> str:
            return page.locator("#plots .u-value").first.inner_text()

        before, numbers = newest(), text(page, "#tiles")
        assert until(lambda: newest() != before and text(page, "#tiles") != numbers)
        page.locator("#hold").click()
        assert page.locator("#hold").get_attribute("aria-pressed") == "true"
        before = newest()
        page.wait_for_timeout(700)
        assert newest() == before
        page.get_by_role("button", name="10 min").press("Space")
        assert page.locator("#spans [aria-pressed=true]").inner_text() == "10 min"


@pytest.mark.parametrize(("size", "scheme"), [(LAPTOP, "dark"), ((320, 640), "light")])
def test_the_page_fits_every_screen_and_scheme(
    browser: Browser, drive: Player, size: tuple[int, int], scheme: str
) -> None:
    with at_work(drive), opened(browser, drive.url, size, scheme) as page:
        page.wait_for_selector("#plots canvas")
        page.wait_for_selector("#memory table")
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width == size[0]
        cut = page.evaluate(
            "[...document.querySelectorAll("
            "'#tiles .value, #conditions .seen, .gauge span, .pairs dd')]"
            ".filter(e => e.scrollWidth > e.clientWidth + 1 && e.clientWidth).map(e => e.innerText)"
        )
        assert cut == []
        background = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert background == {"light": "rgb(245, 246, 248)", "dark": "rgb(18, 22, 28)"}[scheme]


def test_a_broken_stream_is_said_and_comes_back(browser: Browser, late_sensor: list[Frame]) -> None:
    with Player() as player, browser.new_page() as page:
        player.push(late_sensor[:3000])
        page.goto(player.url)
        with at_work(player):
            page.wait_for_selector("#connection.live")
        # WHEN the loop is silent
        page.wait_for_selector("#connection.lost", timeout=10_000)
        assert "the monitor is silent" in text(page, "#connection")
        assert page.evaluate("getComputedStyle(document.querySelector('main')).filter") != "none"
        with at_work(player):
            page.wait_for_selector("#connection.live")
        # WHEN the server dies
        os.kill(player.server.pid, signal.SIGKILL)
        page.wait_for_selector("#connection.lost")
        assert "no connection, trying again" in text(page, "#connection")
        assert "old" in (page.locator("body").get_attribute("class") or "")


def test_a_page_says_that_o2mon_has_ended_and_shows_nothing_of_it_when_it_is_started_again(
    browser: Browser, late_sensor: list[Frame]
) -> None:
    errors: list[str] = []
    with browser.new_page() as page:
        page.on("pageerror", lambda error: errors.append(f"error: {error}"))
        with Player() as player:
            player.push(late_sensor[: 90 * 200])
            page.goto(player.url)
            with at_work(player):
                page.wait_for_selector("#verdict.failed")
            address = player.server.address
        # WHEN it ends
        page.wait_for_selector("#connection.ended")
        assert "o2mon has ended" in text(page, "#connection")
        # WHEN it runs anew at the same address, on a silent bus
        with Player(server=Server(address)) as player, at_work(player):
            page.wait_for_selector("#connection.live", timeout=20_000)
            # THEN code, values and plots are gone
            page.wait_for_selector("#verdict.inconclusive")
            assert text(page, "#verdict-words") == "Waiting for the first samples"
            assert "No code is stored." in text(page, "#codes")
            assert "No window has been filled yet." in text(page, "#windows")
            assert page.locator("#plots canvas").count() == 0
            assert text(page, "#tiles") == ""
    assert errors == []


def test_a_code_of_the_monitor_itself_is_listed_and_is_no_fault_of_the_vehicle(
    browser: Browser, late_sensor: list[Frame]
) -> None:
    store = DtcStore()
    store.fail("memory_lost", 1)
    with Player(store) as player, browser.new_page() as page:
        player.push(late_sensor[:3000])
        page.goto(player.url)
        with at_work(player):
            page.wait_for_selector("#codes .dtc")
            assert "P062F" in text(page, "#codes")
            assert text(page, "#verdict-words") == "Not judged yet"
