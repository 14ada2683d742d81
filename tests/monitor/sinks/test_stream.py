"""Which records a drive gives."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from monitor import cli
from monitor.sinks import vss
from tests.conftest import ROOT

LATE = next((ROOT / "replay_logs").glob("delay_rich_to_lean_*.blf"))


def replayed(out: Path, *options: str) -> list[str]:
    """Return the lines that a replay of the late drive writes."""
    cli.main(["replay", str(LATE), "--quiet", "--sink", f"influx+file:{out}", *options])
    return out.read_text().splitlines()


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], dict[str, Any]]:
    """Give the lines of the late drive, and what the replay's JSON says of it."""
    folder = tmp_path_factory.mktemp("lines")
    lines = replayed(folder / "out.lp", "--json", str(folder / "out.json"))
    return lines, json.loads((folder / "out.json").read_text())["recordings"][0]


def test_a_late_sensor_is_one_verdict_of_windows_one_of_fuel_cuts_and_one_code(
    drive: tuple[list[str], dict[str, Any]],
) -> None:
    lines, recording = drive
    events = [line for line in lines if line.startswith("o2mon_event")]
    [dtc] = recording["dtcs"]
    assert dtc["fault"] == "delay_rich_to_lean"
    assert len(events) == 3
    for event, of in ((events[0], "window"), (events[2], "fuel_cut")):
        assert event.startswith(f"o2mon_event,kind=verdict,of={of} ")
        assert 'verdict="failed",fault="delay_rich_to_lean"' in event
    assert events[1].startswith(f"o2mon_event,code={dtc['code']},kind=code ")
    assert f'state="{dtc["state"]}",status={dtc["status"]}i' in events[1]


def test_signals_come_once_a_second_and_lambda_is_prediction_plus_residual(
    drive: tuple[list[str], dict[str, Any]],
) -> None:
    lines, _ = drive
    signals = [line for line in lines if line.startswith("o2mon ")]
    times_s = [int(line.rpartition(" ")[2]) / 1e9 for line in signals]
    steps_s = {round(b - a, 6) for a, b in pairwise(times_s)}
    assert steps_s == {1.0}
    paths = (f"{vss.OBD}.O2WR.Sensor1.Lambda", vss.PREDICTED, vss.RESIDUAL)
    fields = [dict(f.split("=") for f in line.split(" ")[1].split(",")) for line in signals]
    steady = [[float(each[path]) for path in paths] for each in fields if paths[2] in each]
    assert len(steady) > 300
    fitting = [abs(m - p - r) < 1e-6 for m, p, r in steady]
    assert sum(fitting) > 0.98 * len(fitting)  # not where a value is missing within the second
    assert {each[vss.DTC_COUNT] for each in fields} == {"0i", "1i"}


def test_tags_and_rate_are_the_user_s(tmp_path: Path) -> None:
    lines = replayed(tmp_path / "out.lp", "--sink-rate", "0.1", "--sink-tag", "vehicle=17")
    assert all(re.match(r"o2mon(_event)?,(\w+=\w+,)*vehicle=17 ", line) for line in lines)
    assert 35 < sum(line.startswith("o2mon,") for line in lines) < 50


def test_a_replay_says_which_sink_does_not_take_its_results(
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked = ["replay", str(LATE), "--quiet", "--sink"]
    assert cli.main([*asked, "influx+http://me:secret@127.0.0.1:1/write?db=x"]) == 2
    said = capsys.readouterr().err
    assert "--sink influx+http://127.0.0.1:1/write: " in said
    assert "refused" in said
    assert cli.main([*asked, "prometheus://127.0.0.1:9464"]) == 2
    assert "use prometheus+file:FILE.prom" in capsys.readouterr().err
