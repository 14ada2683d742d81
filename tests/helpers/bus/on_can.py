"""The example that listens on a CAN bus with the exported C monitor, compiled."""

import subprocess
from collections.abc import Sequence
from pathlib import Path

import can

from monitor.base import config
from monitor.controller.export import export
from monitor.pipeline.replay import set_up
from tests.helpers.models import c_monitor

FOLDER = Path(__file__).resolve().parents[3] / "examples" / "controller"
STATUS_ID = 0x5C0  # O2MON_Status of o2_monitor.dbc
FLAG = 0x01  # FaultFlag, in the first byte


def compiled_in(folder: Path) -> Path:
    """Return the example, compiled with the export of the shipped model."""
    setup = set_up(None, [], config.load())
    export(setup.model, setup.config, folder)
    return c_monitor.compiled(folder, folder / "on_can", program=sorted(FOLDER.glob("*.c")))


def statuses(program: Path, frames: Sequence[can.Message]) -> list[bytes]:
    """Return the status frames that the example prints for a log."""
    lines = [
        f"({f.timestamp:.6f}) can0 {f.arbitration_id:0{8 if f.is_extended_id else 3}X}"
        f"#{f.data.hex().upper()}\n"
        for f in frames
    ]
    said = subprocess.run(
        [program, "-"], input="".join(lines), capture_output=True, text=True, check=True
    )
    return [
        bytes.fromhex(line.rpartition(f" {STATUS_ID:X}#")[2])
        for line in said.stdout.split("\n")[:-1]
    ]


def first_flag(payloads: Sequence[bytes]) -> int | None:
    """Return the first sample whose status carries the fault flag."""
    return next((k for k, payload in enumerate(payloads) if payload[0] & FLAG), None)


def without_share(payload: bytes) -> tuple[int, int]:
    """Return a status without EnabledPercent and the checksum over it.

    Behind a pause the loop judges several ticks at once, and each tells the share at their end.
    """
    whole = int.from_bytes(payload, "little")
    return whole & (1 << 36) - 1, whole >> 52 & 15
