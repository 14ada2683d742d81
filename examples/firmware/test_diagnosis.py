"""Does the monitor understand the frames of our ECU program, and find a sensor's fault in them?
Does the program react to the monitor's fault flag?

pytest --junit-xml=report.xml, with CAN_INTERFACE and CAN_CHANNEL as in github.yml
"""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest

import dbc
from monitor.api.scenarios import ScenarioResult
from monitor.decode.bus_map import load_database
from monitor.decode.checksum import payload_checksum

HERE = Path(__file__).parent
DRIVE = HERE.parents[1] / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
SECONDS = 75.0
TIMES_REAL = 10.0  # 1.0 for a program in real time
ECU = [sys.executable, str(HERE / "ecu.py"), str(DRIVE), str(SECONDS), str(TIMES_REAL)]
REACTION = 0x600  # what this ECU sends once it has seen the flag
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


def test_the_ecu_reacts_to_the_fault_flag() -> None:
    # GIVEN the status that o2mon run --transmit sends, here with the flag set
    database = load_database(dbc.path("o2_monitor.dbc"))
    status = database.get_message_by_name("O2MON_Status")
    values = dict.fromkeys((signal.name for signal in status.signals), 0) | {"FaultFlag": 1}
    with can.Bus() as bus, subprocess.Popen(ECU) as program:
        assert bus.recv(20.0), "the program sends nothing"
        for count in range(50):
            data = bytearray(status.encode(values | {"AliveCounter": count % 16}))
            data[7] = payload_checksum("crc8_sae_j1850_id", status.frame_id, data, 7)
            bus.send(can.Message(arbitration_id=status.frame_id, data=data, is_extended_id=False))
            end_s = time.monotonic() + 0.1
            while time.monotonic() < end_s and (message := bus.recv(0.1)):
                # WHEN it comes, THEN the ECU says that it drives in open loop
                if message.arbitration_id == REACTION:
                    program.kill()
                    return
    pytest.fail("no reaction within 5 s")


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
