"""A logger's file of a car without a model of its own: the tests that need no model judge it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor.base.types import FloatArray
from tests.helpers.logs.logger_files import drive, write_text_table
from tests.helpers.logs.replays import replays

RATE_HZ, N = 10.0, 3000  # five minutes


def replayed(
    folder: Path, afr: FloatArray, page: Path | None = None, **more: FloatArray
) -> tuple[int, dict[str, Any]]:
    """Judge a MegaSquirt's log with these readings; write its page, too."""
    d = drive(n=N, period_s=1.0 / RATE_HZ)
    pulse_ms = np.full(N, 3.0)
    columns = {"Time": d["t_s"], "RPM": d["rpm"], "MAP": d["map_kpa"], "AFR": afr, "PW": pulse_ms}
    path = write_text_table(folder / "drive.msl", columns | more)
    options = ("--html", page) if page else ()
    code, (recording,) = replays(path, "--profile", "megasquirt", "--quiet", *options)
    return code, recording


def test_the_page_shows_the_reading_without_a_prediction_and_no_model(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    afr = alive()
    replayed(tmp_path, afr, page=page)
    text = page.read_text()
    assert 'class="model"' not in text
    assert "Measured and predicted" not in text.partition("<script")[0]
    data = json.loads(text.partition('id="series-0">')[2].partition("</script>")[0])
    assert data["measured"] == pytest.approx(afr / 14.7, abs=1e-3)
    assert data["predicted"] == N * [None]


def alive() -> FloatArray:
    return 14.7 + 0.3 * np.random.default_rng(5).standard_normal(N).round(1)


def from_half(afr: FloatArray | float) -> FloatArray:
    return np.where(np.arange(N) < N // 2, alive(), afr)


def test_a_live_sensor_has_no_code_and_the_response_is_not_judged(tmp_path: Path) -> None:
    code, recording = replayed(tmp_path, alive())
    assert (code, recording["dtcs"]) == (3, [])
    assert [each["reason"] for each in recording["not_judged"]] == ["no_model"]
    assert any("electrical" in note for note in recording["notes"])


@pytest.mark.parametrize(("afr", "fault"), [(22.3, "stuck_lean"), (7.4, "stuck_rich")])
def test_a_sensor_at_its_rail_is_found(afr: float, fault: str, tmp_path: Path) -> None:
    code, recording = replayed(tmp_path, from_half(afr))
    assert code == 1
    assert [dtc["fault"] for dtc in recording["dtcs"]] == [fault]


@pytest.mark.parametrize("afr", [7.4, 22.3, 14.7])
def test_a_sensor_that_never_moves_is_not_ready(afr: float, tmp_path: Path) -> None:
    code, recording = replayed(tmp_path, np.full(N, afr))
    assert code == 1
    (dtc,) = recording["dtcs"]
    assert (dtc["code"], dtc["fault"]) == ("P0134", "not_ready")


@pytest.mark.parametrize(
    ("afr", "pulse_ms"),
    [
        (from_half(22.3), np.where(np.arange(N) < N // 2, 3.0, 0.0)),
        (np.where(np.arange(N) < 60 * RATE_HZ, 7.4, alive()), np.full(N, 3.0)),
        (from_half(14.7), np.full(N, 3.0)),
    ],
    ids=["at its lean rail in a fuel cut", "no sensor for a cold minute", "held near one"],
)
def test_a_reading_that_may_be_sound_has_no_code(
    afr: FloatArray, pulse_ms: FloatArray, tmp_path: Path
) -> None:
    code, recording = replayed(tmp_path, afr, PW=pulse_ms)
    assert (code, recording["dtcs"]) == (3, [])
