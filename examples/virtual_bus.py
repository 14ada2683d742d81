"""A drive on a virtual CAN bus, judged live: a fault, the flag on the bus, the code, the live page.

    python examples/virtual_bus.py [--fault delay_rich_to_lean=0.6@20] [--seconds 60]

It takes the SocketCAN bus vcan0, which it sets up if the kernel and the rights allow it; else, and
on macOS, Windows and WSL, python-can's bus ``udp_multicast`` between processes of this machine.
The monitor's flag is read back from the bus, as an instrument cluster would read it.
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import can
import cantools

import dbc

HEALTHY = Path(__file__).parent.parent / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
GROUP = "239.74.163.2"  # of the multicast bus
O2MON = str(Path(sys.executable).with_name("o2mon"))
REFUSALS = {  # of ip(8)
    "Unknown device type": "the kernel has no vcan",
    "not permitted": "the right is missing (a container has it with --cap-add NET_ADMIN)",
}
LOADED_S = 60.0  # longest wait for the monitor's first frame


def main() -> None:
    """Play the drive with the fault into the bus and print what the bus says."""
    options = arguments().parse_args()
    interface, channel, why = bus(options.channel)
    print(f"bus        {interface} {channel}{why}")
    at = ["-i", interface, "-c", channel]
    with tempfile.TemporaryDirectory() as folder:
        log, result = Path(folder) / "drive.log", Path(folder) / "result.json"
        call = [O2MON, "inject", str(options.drive), "--out", str(log), "--fault", options.fault]
        subprocess.run(call, check=True, stdout=subprocess.DEVNULL)
        print(f"drive      {options.drive.name} with {options.fault}")
        run = [O2MON, "run", *at, "--transmit", "--quiet", "--json", str(result)]
        run += ["--duration", str(options.seconds)]
        run += ["--live", options.live] if options.live else []
        monitor = subprocess.Popen(run, stdout=subprocess.DEVNULL)
        player = None
        try:
            with can.Bus(channel, interface=interface) as listener:
                if next(statuses(listener, time.monotonic() + LOADED_S), None) is None:
                    raise SystemExit("the monitor sent nothing, see its message above")
                print(
                    f"live page  {f'http://{options.live}/' if options.live else 'none'}",
                    flush=True,
                )
                play = [sys.executable, "-m", "can.player", *at, str(log)]
                player = subprocess.Popen(play, stdout=subprocess.DEVNULL)
                begin_s = time.monotonic()
                for said, _ in groupby(statuses(listener, begin_s + options.seconds)):
                    print(f"{time.monotonic() - begin_s:6.1f} s   {said}", flush=True)
            monitor.wait(LOADED_S)
        finally:
            for each in (player, monitor):
                if each is not None and each.poll() is None:
                    each.terminate()
                    each.wait()
        drive = json.loads(result.read_text())["recordings"][0]
    told = ", ".join(f"{each['code']} {each['fault']} ({each['state']})" for each in drive["dtcs"])
    why = f"not judged: {drive['not_judged'][0]['advice']}" if drive["not_judged"] else "no fault"
    print(f"verdict    {told or why}")


def arguments() -> argparse.ArgumentParser:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--channel", default="vcan0", help="SocketCAN bus (default: vcan0)")
    parser.add_argument("--drive", type=Path, default=HEALTHY, help="log to play")
    parser.add_argument("--fault", default="delay_rich_to_lean=0.6@20", help="NAME=SEVERITY@SECOND")
    parser.add_argument("--seconds", type=float, default=60.0, help="on the bus (default: 60)")
    parser.add_argument("--live", default="127.0.0.1:8080", help="address of the page; '' is none")
    return parser


def bus(channel: str) -> tuple[str, str, str]:
    """Return interface and channel, and why it is not SocketCAN; a missing vcan is set up."""
    if sys.platform != "linux":
        return multicast(f"{sys.platform} has no SocketCAN")
    if not Path("/sys/class/net", channel).exists():
        link = ["ip", "link"] if os.geteuid() == 0 else ["sudo", "--non-interactive", "ip", "link"]
        for words in (["add", "dev", channel, "type", "vcan"], ["set", channel, "up"]):
            try:
                subprocess.run([*link, *words], check=True, capture_output=True, text=True)
            except FileNotFoundError:
                lacks = {
                    "ip": "iproute2 is not installed",
                    "sudo": "not root, and there is no sudo",
                }
                return multicast(f"no {channel}: {lacks[link[0]]}")
            except subprocess.CalledProcessError as error:
                said = error.stderr.strip()
                meant = (REFUSALS[each] for each in REFUSALS if each in said)
                return multicast(f"no {channel}: {next(meant, said)}")
    return "socketcan", channel, ""


def multicast(why: str) -> tuple[str, str, str]:
    """Return the bus between processes and why it is taken; without a network there is none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        group = socket.inet_aton(GROUP) + socket.inet_aton("0.0.0.0")
        try:
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        except OSError as error:
            raise SystemExit(
                f"no bus     {why}; no udp_multicast: {error.strerror}, it needs a network "
                "(a container's --network none has none)"
            ) from None
    return "udp_multicast", GROUP, f" ({why})"


def statuses(listener: can.BusABC, until_s: float) -> Iterator[str]:
    """Yield the monitor's status frames in words, until the monotonic time ``until_s``."""
    database = cantools.database.can.Database()
    database.add_dbc_file(str(dbc.path("o2_monitor.dbc")))
    status = database.get_message_by_name("O2MON_Status")
    while (left_s := until_s - time.monotonic()) > 0.0:
        frame = listener.recv(left_s)
        if frame is not None and frame.arbitration_id == status.frame_id:
            values = status.decode(bytes(frame.data), decode_choices=True)
            assert isinstance(values, dict)
            flag = (
                f"fault flag set, code P{values['Dtc']:04X}" if values["FaultFlag"] else "no flag"
            )
            yield f"{values['MonitorState']}, {flag}"


if __name__ == "__main__":
    main()
