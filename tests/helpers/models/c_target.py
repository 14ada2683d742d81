"""The exported C on a Cortex-M4F: sizes, stack, and drives in an emulator."""

import re
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from tests.helpers.models.c_monitor import ANY, DRIVER, STRICT

TOOLS = ("arm-none-eabi-gcc", "qemu-system-arm")
PLACE = Path(__file__).with_name("target")
CORE = (
    *("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-Os"),
    *("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"),
)
LIBM_STACK = 96  # bytes, of the deepest function of newlib's libm that is called
INSTRUCTIONS_PER_TICK = 40  # one takes 1 ns, the timer counts at 25 MHz


class Sizes(NamedTuple):
    """What the monitor takes of a controller, in bytes."""

    flash: int
    ram: int
    stack: int


def sizes(folder: Path) -> Sizes:
    """Return the sizes of an exported monitor, libm included, names left out."""
    main, out = folder / "size.c", folder / "size.elf"
    main.write_text(
        '#include "o2_monitor.h"\no2_monitor own;\no2_sample sample;\no2_result result;\n'
        "void entry(void);\nvoid entry(void)\n{\n    o2_init(&own, &o2_any_vehicle);\n"
        "    o2_step(&own, &sample, &result);\n}\n"
    )
    files = [main, *sorted(folder.glob("o2_*.c"))]
    call = ["arm-none-eabi-gcc", *STRICT, *CORE, "-fcallgraph-info=su", f"-I{folder}"]
    call += ["-nostartfiles", "-Wl,--entry=entry", "--specs=nano.specs", "-o", out, *files, "-lm"]
    subprocess.run(call, check=True, cwd=folder)
    said = subprocess.run(["arm-none-eabi-size", out], capture_output=True, text=True, check=True)
    text, data, bss = map(int, said.stdout.splitlines()[1].split()[:3])
    return Sizes(text + data, data + bss, _stack(list(folder.glob("*.ci"))))


def _stack(graphs: Sequence[Path]) -> int:
    """Return the most bytes of stack below ``entry``; fails where a function calls itself."""
    own: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for graph in graphs:
        text = graph.read_text()
        for name, size in re.findall(r'node: \{ title: "([^"]+)" label: ".*?(\d+) bytes', text):
            own[name] = int(size)
        for caller, callee in re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls.setdefault(caller, set()).add(callee)

    @cache
    def deepest(name: str) -> int:  # a cycle ends in a RecursionError
        below = max((deepest(callee) for callee in calls.get(name, ())), default=0)
        return own.get(name, LIBM_STACK) + below

    return deepest("entry")


def emulated(folder: Path, drive: Path) -> tuple[str, float, float]:
    """Return what the driver prints of a drive, and the instructions of all steps and of one."""
    out = folder / "m4.elf"
    files = [*sorted(folder.glob("o2_*.c")), DRIVER, PLACE / "start.c", "-T", PLACE / "mps2.ld"]
    call = ["arm-none-eabi-gcc", "-std=c99", *CORE, "-DO2_TICKS", f"-I{folder}", "-o", out]
    subprocess.run([*call, *files, "--specs=rdimon.specs", "-lm"], check=True)
    words = ",".join(f"arg={word}" for word in ("m4", *ANY, drive.name))
    machine = ["qemu-system-arm", "-M", "mps2-an386", "-cpu", "cortex-m4", "-icount", "shift=0"]
    machine += ["-display", "none", "-monitor", "none", "-serial", "none", "-kernel", str(out)]
    machine += ["-semihosting-config", f"enable=on,target=native,{words}"]
    done = subprocess.run(
        machine, cwd=drive.parent, capture_output=True, text=True, check=True, timeout=100
    )
    _, ticks, _, most = done.stderr.split()[:4]
    return done.stdout, *(float(each) * INSTRUCTIONS_PER_TICK for each in (ticks, most))
