"""A scenario from Python: verdicts, times to detection, and assertions that can be read."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from monitor.api.scenarios import ScenarioResult, play_scenario
from monitor.base.errors import UsageError
from tests.conftest import ROOT

LATE = "delay_rich_to_lean=0.6@20"


@pytest.fixture(scope="module")
def late(ninety_seconds: Path) -> ScenarioResult:
    return play_scenario(ninety_seconds, faults=[LATE])


def test_a_late_sensor_has_its_code_and_the_time_to_its_detection(late: ScenarioResult) -> None:
    assert late.codes == ("P015A",)
    time_s = late.detection_s["P015A"]
    assert time_s == late.verdict.codes[0].t_s - 20.0  # type: ignore[operator]
    assert 10.0 < time_s < 30.0
    assert late.assert_codes("P015A", state="pending", within_s=30.0) is late
    assert repr(late) == f"<ScenarioResult drive 1: {late.verdict}>"
    assert "FAULT: P015A delay_rich_to_lean (pending, 43 s)" in str(late.verdict)


@pytest.mark.parametrize(
    ("codes", "state", "within_s", "row"),
    [
        (["P015A"], "", 5.0, "1      P015A within 5 s  P015A pending (delay_rich_to_lean) after "),
        (["P015A"], "confirmed", 60.0, "1      P015A confirmed within 60 s  P015A pending"),
        (["P0133"], "", 60.0, "1      no other code      P015A pending"),
        (["P015A", "P0133"], "", 60.0, "1      P0133 within 60 s  P015A pending"),
        ([], "", 60.0, "1      no code, judged  P015A pending"),
    ],
)
def test_a_wrong_assertion_fails_with_the_faults_and_a_table(
    late: ScenarioResult, codes: list[str], state: str, within_s: float, row: str
) -> None:
    with pytest.raises(AssertionError) as failed:
        late.assert_codes(*codes, state=state, within_s=within_s)
    title, head, *rows = str(failed.value).splitlines()
    assert title == "healthy.log with delay_rich_to_lean=0.6 from 20 s"
    assert head.split() == ["drive", "expected", "seen"]
    assert any(each.startswith(row) and each.endswith("NOT MET") for each in rows), rows


def test_a_code_that_a_drive_could_not_show_is_unmet(ninety_seconds: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.log"
    short.write_text("".join(ninety_seconds.read_text().splitlines(keepends=True)[:4000]))
    with pytest.raises(AssertionError, match=r"no code, not judged: the lambda .* NOT MET"):
        play_scenario(short, faults=["gain_low"]).assert_codes("P2A00")


def test_the_drives_of_a_scenario_share_one_memory(ninety_seconds: Path) -> None:
    scenario = ROOT / "docs" / "scenarios" / "late_sensor_confirmed.toml"
    result = play_scenario(ninety_seconds, scenario)
    states = [[code.state for code in verdict.codes] for verdict in result.verdicts]
    assert states == [["pending"], ["confirmed"]]
    result.assert_met()
    # and a further fault changes what is seen
    worse = play_scenario(ninety_seconds, scenario, faults=["stuck_at_one"])
    with pytest.raises(AssertionError, match=r"^A sensor that is late.*\n(.*\n)*1 .*NOT MET"):
        worse.assert_met()


def test_a_healthy_drive_has_no_code_and_nothing_to_be_met(ninety_seconds: Path) -> None:
    healthy = play_scenario(ninety_seconds)
    assert healthy.assert_codes().detection_s == {}
    with pytest.raises(UsageError, match="no \\[\\[expect\\]\\]"):
        healthy.assert_met()


def test_the_fixture_imports_nothing_heavy_until_a_test_asks_for_it(tmp_path: Path) -> None:
    (tmp_path / "test_of_a_user.py").write_text(
        "import sys\n"
        "def test_before():\n    assert not {'numpy', 'can', 'onnxruntime'} & set(sys.modules)\n"
        "def test_with(o2_scenario):\n    assert o2_scenario.__name__ == 'play_scenario'\n"
    )
    call = [sys.executable, "-m", "pytest", "-q", "-p", "monitor.api.pytest_plugin"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    ran = subprocess.run(
        call, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert "2 passed" in ran.stdout, ran.stdout
