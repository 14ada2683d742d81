"""The example on a virtual bus in a network of its own, as a container has it."""

import sys
from collections.abc import Callable

import pytest

from tests.conftest import ROOT
from tests.vcan import guest

BUS = "from examples.virtual_bus import bus; print(*bus('vcan0'), sep='')"
CONTAINER = """
inside() { # COMMANDS RIGHT WORDS: of Python, after commands in the new network
  unshare --net --mount sh -c "mount -t sysfs sys /sys; ip link set lo up; $1
    setpriv --bounding-set $2 '$python' $3"
}
inside : +net_admin "-c \\"$bus\\""
inside : -net_admin "-c \\"$bus\\""
inside 'ip route add multicast 239.0.0.0/8 dev lo' -net_admin "-c \\"$bus\\""
inside : -net_admin "-m monitor.cli check -i udp_multicast -c 239.74.163.2"
"""


def test_a_container_gets_its_bus_by_its_rights_and_its_network_or_is_told_what_lacks(
    run_with_vcan: Callable[..., guest.Finished],
) -> None:
    if guest.find_place() == "host":
        pytest.skip("this user may not make networks")
    shell = ["env", f"python={sys.executable}", f"bus={BUS}", "sh", "-c", CONTAINER]
    said = run_with_vcan(shell, ROOT, timeout_s=120.0).stdout
    made, refused, shared, checked = said.splitlines()
    lacks = "no vcan0: the right is missing (a container has it with --cap-add NET_ADMIN)"
    assert made == "socketcanvcan0"
    assert refused.startswith(f"no bus     {lacks}; no udp_multicast: ")
    assert shared == f"udp_multicast239.74.163.2 ({lacks})"
    assert checked.endswith("it needs a network, and here is none (a container's --network none?)")
