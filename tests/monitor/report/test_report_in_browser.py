"""The report in a real browser: pictures of the whole page and prints have every plot."""

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from tests.monitor.report.test_report import faulty, not_judged, recording, trace, written

PLOTS = "() => [...document.querySelectorAll('section.plots')]"
CANVASES = f"() => ({PLOTS})().map((s) => s.querySelectorAll('canvas').length)"
MEASURED = """() => {
  const canvas = document.querySelector("section.plots canvas"), { width, height } = canvas;
  const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
  let found = 0;
  for (let i = 0; i < pixels.length; i += 4)
    if (pixels[i] === 11 && pixels[i + 1] === 98 && pixels[i + 2] === 176) found++;
  return found;
}"""
INKED = f"""() => ({PLOTS})().map((section) => [...section.querySelectorAll("canvas")].every(
  (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height)
    .data.some((value) => value)))"""


def test_a_page_that_nobody_scrolled_has_the_plots_of_every_recording(
    browser: Browser, tmp_path: Path
) -> None:
    # GIVEN a report on four drives, far longer than the window
    written(tmp_path, recording(), faulty(), recording("drives/3.log"), recording("drives/4.log"))
    page = browser.new_page(viewport={"width": 1366, "height": 300})
    page.goto((tmp_path / "report.html").as_uri())
    # WHEN nobody scrolls THEN the plots of all are drawn all the same
    drawn = f"() => ({CANVASES})().every((number) => number === 5)"
    page.wait_for_function(drawn, timeout=20_000, polling=200)
    assert page.evaluate(INKED) == 4 * [True]
    # AND the print has them too
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(CANVASES) == 4 * [5]
    assert page.evaluate(INKED) == 4 * [True]
    page.close()


@pytest.mark.parametrize("lean", [1.0, 1.6])
def test_a_sensor_that_always_reads_beyond_the_range_of_lambda_is_drawn(
    browser: Browser, tmp_path: Path, lean: float
) -> None:
    series = trace()
    series.measured[:] = lean + 0.01 * np.sin(series.t_s)
    written(tmp_path, recording(), traces=[series])
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    page.wait_for_function(f"() => ({CANVASES})()[0] === 5", timeout=20_000, polling=200)
    assert page.evaluate(MEASURED) > 300
    page.close()


def test_plots_that_were_folded_at_sunset_unfold_dark(browser: Browser, tmp_path: Path) -> None:
    written(tmp_path, recording())
    page = browser.new_page(color_scheme="light")
    page.goto((tmp_path / "report.html").as_uri())
    page.wait_for_function(f"() => ({CANVASES})()[0] === 5", timeout=20_000, polling=200)
    # GIVEN a recording that is folded while the colours change
    page.locator(".recording > summary").click()
    page.emulate_media(color_scheme="dark")
    page.locator(".recording > summary").click()
    # THEN no line has its colour of the day
    page.wait_for_function(f"() => ({MEASURED})() === 0", timeout=10_000, polling=200)
    assert page.evaluate(CANVASES)[0] == 5
    page.close()


def test_a_log_that_no_model_judged_has_one_plot_and_says_so(
    browser: Browser, tmp_path: Path
) -> None:
    bare = not_judged()
    del bare["limits"], bare["enable"]
    written(tmp_path, bare)
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    # THEN the measured lambda is drawn, and nothing else
    page.wait_for_function(f"() => ({CANVASES})()[0] === 1", timeout=20_000, polling=200)
    assert page.evaluate(INKED) == [True]
    text = page.inner_text("section.plots")
    assert "Measured lambda" in text
    assert "No prediction is drawn: no model judged this recording." in text
    assert not page.query_selector("section.model")
    page.close()
