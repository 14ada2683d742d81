"""On a Cortex-M4F the exported monitor fits its budget and judges as on the host."""

import shutil
from pathlib import Path

import pytest

from monitor.controller.export import export
from monitor.pipeline.replay import Setup
from tests.helpers.drives.drive_tables import read
from tests.helpers.logs.replays import replay_log
from tests.helpers.models import c_monitor, c_target

MISSING = [tool for tool in c_target.TOOLS if not shutil.which(tool)]
pytestmark = pytest.mark.skipif(
    bool(MISSING),
    reason="apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm",
)
FLASH, RAM, STACK = 15_500, 4_096, 3_072  # bytes
HERTZ = 80e6  # of the core that the budget is for


@pytest.fixture(scope="module")
def exported(setup: Setup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("m4")
    export(setup.model, setup.config, folder)
    return folder


def test_flash_ram_and_stack_are_within_their_budget(exported: Path) -> None:
    own = c_target.sizes(exported)
    print(f"flash {own.flash} bytes, RAM {own.ram} bytes, stack {own.stack} bytes")
    assert own.flash <= FLASH
    assert own.ram <= RAM
    assert own.stack <= STACK


@pytest.mark.parametrize("kind", ["healthy_micro", "slow_symmetric"])
def test_a_drive_is_judged_on_the_core_as_in_python(
    kind: str, setup: Setup, exported: Path
) -> None:
    # GIVEN a replay log as samples for the controller
    drive = read(replay_log(kind), setup)
    (python,) = c_monitor.in_python([drive.block], drive.names, setup)
    given = c_monitor.rows(drive.block, drive.names, c_monitor.source_of(setup))
    file = exported / "drive.bin"
    file.write_bytes(c_monitor.content_of([given]))
    # WHEN the emulated core judges them
    said, instructions, most = c_target.emulated(exported, file)
    share = instructions / (len(given) * setup.model.card.period_ns * 1e-9) / HERTZ
    print(f"{kind}: {100 * share:.2f} % of 80 MHz, longest step {most:.0f} instructions")
    # THEN windows and codes are the same, in a small part of the core's time
    (c,) = c_monitor.said_by(said)
    assert c_monitor.differences(python, c) == []
    assert share <= 0.005
