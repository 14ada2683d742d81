"""Does the monitor understand the frames of our ECU program, and find a sensor's fault in them?

pytest --junit-xml=report.xml, with CAN_INTERFACE and CAN_CHANNEL as in github.yml
"""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from monitor.api.scenarios import ScenarioResult

HERE = Path(__file__).parent
DRIVE = HERE.parents[1] / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
SECONDS = 75.0
TIMES_REAL = 10.0  # 1.0 for a program in real time
ECU = [sys.executable, str(HERE / "ecu.py"), str(DRIVE), str(SECONDS), str(TIMES_REAL)]
Play = Callable[..., ScenarioResult]


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the ECU program once and record its frames; all scenarios take this drive."""
    log = tmp_path_factory.mktemp("drive") / "drive.log"
    with can.Bus() as bus, can.Logger(log) as logger, subprocess.Popen(ECU) as program:
        first_s = None
        while (message := bus.recv(2.0)) or program.poll() is None:
            if message:
                first_s = message.timestamp if first_s is None else first_s
                message.timestamp = (message.timestamp - first_s) * TIMES_REAL
                logger(message)
    assert program.returncode == 0
    return log


def test_a_healthy_drive_has_no_code(o2_scenario: Play, drive: Path) -> None:
    o2_scenario(drive).assert_codes()


@pytest.mark.parametrize("path", sorted(HERE.glob("scenarios/*.toml")), ids=lambda path: path.stem)
def test_a_scenario_is_met(o2_scenario: Play, drive: Path, path: Path) -> None:
    o2_scenario(drive, path).assert_met()


@pytest.mark.parametrize(
    ("fault", "code"), [("gain_low=0.4@20", "P2A00"), ("stuck_at_one@20", "P0134")]
)
def test_a_fault_is_found(o2_scenario: Play, drive: Path, fault: str, code: str) -> None:
    o2_scenario(drive, faults=[fault]).assert_codes(code, state="pending", within_s=50.0)
