"""The report in a real browser: pictures of the whole page and prints have every plot."""

from pathlib import Path

from playwright.sync_api import Browser

from tests.monitor.report.test_report import faulty, not_judged, recording, written

PLOTS = "() => [...document.querySelectorAll('section.plots')]"
CANVASES = f"() => ({PLOTS})().map((s) => s.querySelectorAll('canvas').length)"
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


def test_a_log_that_no_model_judged_has_one_plot_and_says_so(
    browser: Browser, tmp_path: Path
) -> None:
    # GIVEN a report on a log without a model of its car
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
