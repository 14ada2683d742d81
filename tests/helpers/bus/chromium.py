"""Debian's chromium, headless, for the tests of pages."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

DRAWN = """() => [...document.querySelectorAll("figure.plots")].every(
  (figure) => figure.querySelector("canvas"))"""
INKED = """() => [...document.querySelectorAll("figure.plots canvas")].filter(
  (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height)
    .data.some((value) => value)).length"""

CHROMIUM = Path("/usr/bin/chromium")


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run the browser; without one the test is skipped, or fails if O2_REQUIRE_BROWSER=1."""
    if not CHROMIUM.exists():
        reason = f"no {CHROMIUM}; apt-get install chromium"
        if os.environ.get("O2_REQUIRE_BROWSER") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        yield browser
        browser.close()


def plots_of(browser: Browser, path: Path) -> int:
    """Return how many plots a page of training draws, all unfolded; its console stays silent."""
    page = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme="dark")
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(path.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    page.wait_for_function(DRAWN, timeout=20_000, polling=100)
    canvases = page.evaluate("document.querySelectorAll('canvas').length")
    inked = page.evaluate(INKED)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.close()
    assert said == []
    assert inked == canvases
    return int(inked)
