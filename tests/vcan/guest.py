"""Run a command where virtual CAN buses are up: on this kernel, or in a User-Mode Linux guest.

The first of these that works here is taken:

1. a network namespace of this kernel with its own ``vcan0``, ``vcan1``;
2. the ``vcan`` interfaces this machine already has, one user at a time;
3. User-Mode Linux, a kernel that runs as an ordinary process on the host's own files. It has one
   CPU and slow system calls, so keep a bus in it below 300 frames/s.
"""

import fcntl
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Literal

Place = Literal["namespace", "host", "user-mode-linux"]
Finished = subprocess.CompletedProcess[str]

HOW_TO_INSTALL = (
    "this kernel has no vcan and User-Mode Linux is not complete: {missing} not found; "
    "apt-get install user-mode-linux kmod iproute2{and_more}"
)
WHOLE_REGISTERS = Path(__file__).with_name("whole_registers.c")
WITHOUT_MDF = Path(__file__).with_name("without_mdf")  # python-can imports asammdf for 1.5 s
SYSTEM_PATH = f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/usr/bin:/sbin:/bin"
GUEST_MEMORY = 2 << 30  # bytes; a sparse file, only what the guest touches is taken
KEPT_VARIABLES = ("HOME", "LANG", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")

BUSES_UP = """\
ip link set dev lo up
for bus in {buses}; do
  ip link add dev "$bus" type vcan || exit 125
  ip link set dev "$bus" up || exit 125
done
"""

GUEST_INIT = """\
#!/bin/sh
export PATH={path}
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mount -t tmpfs tmp /run
for module in can-dev can can-raw vcan; do
  insmod "$(find /usr/lib/uml/modules/$(uname -r) -name "$module.ko*")"
done
(
{buses_up}
export TMPDIR=/run PYTHONDONTWRITEBYTECODE=1
{variables}
cd {workdir} && exec {command}
) < /dev/null > {scratch}/output 2>&1
echo $? > {scratch}/returncode
sync
{python} -S -c 'import ctypes; ctypes.CDLL(None).reboot(0x4321FEDC)'  # RB_POWER_OFF
"""


class VcanUnavailableError(Exception):
    """No way to a virtual CAN bus on this machine; the message says what to install."""


def run_with_vcan(
    command: Sequence[str | Path], workdir: Path, timeout_s: float, n_buses: int = 1
) -> Finished:
    """Run ``command`` in ``workdir`` with vcan0 (vcan1, …) up; return its exit code and output.

    stdout and stderr come back together in ``stdout``.
    Raises VcanUnavailableError, and subprocess.TimeoutExpired after killing what was started.
    """
    path = os.pathsep.join((str(WITHOUT_MDF), os.environ.get("PYTHONPATH", "")))
    argv = ["env", f"PYTHONPATH={path}", *map(str, command)]
    buses = [f"vcan{number}" for number in range(n_buses)]
    place = find_place()
    if place == "namespace":
        return _run([*_namespace_command(buses), *argv], workdir, timeout_s)
    if place == "host":
        absent = [bus for bus in buses if not Path("/sys/class/net", bus).exists()]
        if absent:
            raise VcanUnavailableError(f"{absent[0]}: no such interface, and no right to make it")
        with _one_at_a_time():
            return _run(argv, workdir, timeout_s)
    with _one_at_a_time():  # two guests side by side would not keep pace in real time
        return _run_in_guest(argv, buses, workdir, timeout_s)


@cache
def find_place() -> Place:
    """Return where a virtual CAN bus is to be had; raises VcanUnavailableError."""
    if _kernel_has_can():
        probe = subprocess.run(
            [*_namespace_command(["vcan0"]), "true"], capture_output=True, check=False
        )
        if probe.returncode == 0:
            return "namespace"
        if Path("/sys/class/net/vcan0").exists():
            return "host"
    tools = ["linux.uml", "insmod", "ip", *(["cc"] if _has_amx() else [])]
    missing = [tool for tool in tools if not shutil.which(tool, path=SYSTEM_PATH)]
    if missing:
        and_more = " gcc libc6-dev" if _has_amx() else ""
        raise VcanUnavailableError(
            HOW_TO_INSTALL.format(missing=", ".join(missing), and_more=and_more)
        )
    return "user-mode-linux"


@contextmanager
def _one_at_a_time() -> Iterator[None]:
    """Wait until no other process of this user holds this."""
    with Path(tempfile.gettempdir(), f"o2-monitor-vcan-{os.getuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _kernel_has_can() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def _has_amx() -> bool:
    return "amx_tile" in Path("/proc/cpuinfo").read_text(encoding="utf-8")


def _namespace_command(buses: Sequence[str]) -> list[str]:
    """Return the words before a command that give it a network of its own with these buses."""
    unshare = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--net"]
    script = BUSES_UP.format(buses=" ".join(buses)) + 'exec "$@"'
    return ["env", f"PATH={SYSTEM_PATH}", *unshare, "sh", "-c", script, "sh"]


def _run(argv: Sequence[str], workdir: Path, timeout_s: float) -> Finished:
    """Run ``argv`` in a process group of its own; nothing of it survives this call."""
    with subprocess.Popen(
        argv,
        cwd=workdir,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            output, _ = process.communicate(timeout=timeout_s)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    return subprocess.CompletedProcess(argv, process.returncode, output)


def _run_in_guest(
    argv: Sequence[str], buses: Sequence[str], workdir: Path, timeout_s: float
) -> Finished:
    with tempfile.TemporaryDirectory(prefix="uml-") as scratch:  # short: a socket lies in it
        init = Path(scratch, "init")
        init.write_text(_guest_init(argv, buses, workdir, scratch), encoding="utf-8")
        init.chmod(0o755)
        boot = [
            "env",
            f"PATH={SYSTEM_PATH}",
            f"TMPDIR={_memory_folder(scratch)}",
            *([f"LD_PRELOAD={_whole_registers(scratch)}"] if _has_amx() else []),
            # First of all processes, to keep pace in real time; without the right it is as others.
            *("nice", "-n", "-20"),
            *("linux.uml", f"mem={GUEST_MEMORY >> 20}M", f"uml_dir={scratch}", "quiet"),
            *("rootfstype=hostfs", "hostfs=/", "rw", f"init={init}", "con=null", "con0=null,fd:1"),
        ]
        try:
            console = _run(boot, workdir, timeout_s).stdout
        except subprocess.TimeoutExpired as late:
            late.output = _text(Path(scratch, "output"))
            raise
        returncode = _text(Path(scratch, "returncode")).strip()
        if not returncode:
            raise RuntimeError(f"User-Mode Linux came to no end, its console said:\n{console}")
        return subprocess.CompletedProcess(argv, int(returncode), _text(Path(scratch, "output")))


def _whole_registers(scratch: str) -> Path:
    """Compile what User-Mode Linux needs on a processor with AMX; return the library's path."""
    library = Path(scratch, "whole_registers.so")
    command = ["cc", "-shared", "-fPIC", "-o", library, WHOLE_REGISTERS]
    subprocess.run(command, check=True, env={"PATH": SYSTEM_PATH})
    return library


def _guest_init(argv: Sequence[str], buses: Sequence[str], workdir: Path, scratch: str) -> str:
    kept = {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}
    return GUEST_INIT.format(
        path=shlex.quote(SYSTEM_PATH),
        buses_up=BUSES_UP.format(buses=" ".join(buses)),
        variables="\n".join(f"export {name}={shlex.quote(kept[name])}" for name in kept),
        workdir=shlex.quote(str(workdir.resolve())),
        command=shlex.join(argv),
        scratch=shlex.quote(scratch),
        python=shlex.quote(sys.executable),
    )


def _memory_folder(otherwise: str) -> str:
    """Return where the guest's memory is kept; a container's /dev/shm is often too small."""
    shared_memory = Path("/dev/shm")
    roomy = shared_memory.is_dir() and shutil.disk_usage(shared_memory).free > GUEST_MEMORY
    return str(shared_memory) if roomy else otherwise


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
