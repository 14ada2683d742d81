"""DM1, DM2 and DM3 on a truck's bus; can-j1939 is the other side."""

import time
from collections.abc import Callable, Iterator

import can
import j1939
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor import cli
from monitor.base.errors import UsageError
from monitor.base.types import Frame
from monitor.bus.attachment import filters
from monitor.bus.j1939.codes import NUMBERS, dm1, dm2, packed
from monitor.bus.j1939.node import (
    ACKNOWLEDGEMENT,
    BUSY,
    DM2,
    DM3,
    NEGATIVE,
    POSITIVE,
    Node,
    address,
    name_of,
)
from monitor.bus.link.recorder import message_of
from monitor.memory.codes import CODES
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.events import DtcChanged
from tests.helpers.diagnostics_state import Vehicle, tick
from tests.helpers.examples import inputs

OWN, TOOL = 0x5A, 0xF9


def store_of(*faults: str, cycles: int = 2) -> DtcStore:
    """Return a memory in which the faults failed in so many driving cycles."""
    store = DtcStore()
    for _ in range(cycles):
        store.start_driving_cycle()
        for fault in faults:
            store.fail(fault, 5)
    return store


def vehicle_of(store: DtcStore) -> Vehicle:
    vehicle = Vehicle(0.0)
    vehicle.store = vehicle.state.store = store
    return vehicle


class Truck:
    """A bus with the node, driven by hand, and a service tool of can-j1939."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._bus = can.Bus(interface="virtual", channel="truck")
        self.ecu = j1939.ElectronicControlUnit()
        self.ecu.connect(interface="virtual", channel="truck")
        name = j1939.Name(identity_number=7)
        self.tool = j1939.ControllerApplication(name, TOOL, bypass_address_claim=True)
        self.ecu.add_ca(controller_application=self.tool)
        self.heard: list[tuple[int, int, bytes]] = []
        self.tool.subscribe(
            lambda _p, pgn, source, _t, data: self.heard.append((pgn, source, bytes(data)))
        )

    def run(self, until: Callable[[], bool], seconds: float = 4.0) -> bool:
        """Let the node work until a condition holds."""
        wanted, until_s = set(self._node.identifiers), time.monotonic() + seconds
        while time.monotonic() < until_s and not until():
            message = self._bus.recv(0.005)
            if message and (message.arbitration_id, message.is_extended_id) in wanted:
                data = bytes(message.data)
                self._node.receive(Frame(0, message.arbitration_id, True, data))
            for frame in self._node.work(time.monotonic()):
                self._bus.send(message_of(frame))
        return until()

    @property
    def acknowledged(self) -> list[int]:
        """Return the control bytes of the acknowledgements of DM3 to the tool."""
        about = bytes((0xFF, 0xFF, 0xFF, TOOL)) + DM3.to_bytes(3, "little")
        return [data[0] for data in self.told(ACKNOWLEDGEMENT) if data[1:] == about]

    def told(self, pgn: int) -> list[bytes]:
        return [data for group, source, data in self.heard if (group, source) == (pgn, OWN)]

    def close(self) -> None:
        self.ecu.disconnect()
        self._bus.shutdown()


@pytest.fixture
def vehicle() -> Vehicle:
    return vehicle_of(store_of("slow_symmetric", "biased_lean", "catalyst_low"))


@pytest.fixture
def truck(vehicle: Vehicle) -> Iterator[Truck]:
    truck = Truck(Node(vehicle.state, OWN, pytest.fail))
    yield truck
    truck.close()


def test_a_service_tool_reads_active_and_previous_codes_and_clears(
    truck: Truck, vehicle: Vehicle
) -> None:
    # GIVEN three confirmed codes that fail
    reader, seen = j1939.Dm1(truck.tool), []
    reader.subscribe(lambda source, lamps, codes, _t: seen.append((source, lamps["mil"], codes)))
    # THEN DM1 has them, as a broadcast of several packets
    assert truck.run(lambda: bool(seen))
    source, lamp, codes = seen[0]
    assert (source, lamp) == (OWN, j1939.DtcLamp.ON)
    assert codes == [
        {"spn": 3217, "fmi": 10, "oc": 2},
        {"spn": 3050, "fmi": 17, "oc": 2},
        {"spn": 3217, "fmi": 20, "oc": 2},
    ]
    # AND DM3 is refused while they are active
    truck.tool.send_request(0, DM3, OWN)
    assert truck.run(lambda: len(truck.acknowledged) == 1)
    assert truck.acknowledged[-1] == NEGATIVE
    assert vehicle.clearings == 0
    # WHEN the next driving cycle begins THEN they are previously active
    vehicle.store.start_driving_cycle()
    truck.tool.send_request(0, DM2, OWN)
    assert truck.run(lambda: bool(truck.told(DM2)))
    assert truck.told(DM2)[0] == dm2(vehicle.store)
    assert truck.told(DM2)[0][2:6] == packed(3217, 10, 2)
    # AND DM3 clears them, but not while the engine runs
    vehicle.state.push(tick(800.0))
    truck.tool.send_request(0, DM3, OWN)
    assert truck.run(lambda: len(truck.acknowledged) == 2)
    assert truck.acknowledged[-1] == BUSY
    assert vehicle.clearings == 0
    vehicle.state.push(tick(0.0))
    truck.tool.send_request(0, DM3, OWN)
    assert truck.run(lambda: len(truck.acknowledged) == 3)
    assert truck.acknowledged[-1] == POSITIVE
    assert vehicle.clearings == 1
    assert not vehicle.store.active


def node_of(vehicle: Vehicle, said: list[str] | None = None) -> Node:
    return Node(vehicle.state, OWN, (said if said is not None else []).append)


def sent(node: Node, now_s: float, *received: tuple[int, str]) -> list[tuple[str, str]]:
    """Return identifiers and data of what the node sends on received frames."""
    for can_id, data in received:
        assert (can_id, True) in node.identifiers
        node.receive(Frame(0, can_id, True, bytes.fromhex(data)))
    return [(f"{f.can_id:08X}", f.data.hex(" ")) for f in node.work(now_s)]


def test_dm1_comes_every_second_and_at_once_when_a_code_changes() -> None:
    vehicle = vehicle_of(DtcStore())
    node = node_of(vehicle)
    own_name = name_of("WVWZZZ1JZXW386759").hex(" ")
    healthy = [("18FECA5A", "3f ff 00 00 00 00 ff ff")]
    assert sent(node, 0.0) == [("18EEFF5A", own_name)]
    assert sent(node, 0.2) == []  # another node may still claim the address
    assert sent(node, 0.25) == healthy
    assert sent(node, 1.2) == []
    assert node.due_s == 1.25
    assert sent(node, 1.25) == healthy
    vehicle.store.fail("gain_low", 7)
    for each in vehicle.store.active:
        node.push(DtcChanged(7, each))
    assert sent(node, 1.3) == [("18FECA5A", "3f ff " + packed(3217, 13, 1).hex(" ") + " ff ff")]


def test_requests_that_cannot_be_met_are_refused_unless_they_go_to_everybody() -> None:
    node = node_of(vehicle_of(DtcStore()))
    sent(node, 0.0)
    refused = [("18E8FF5A", "01 ff ff ff f9 eb fe 00")]
    assert sent(node, 0.1, (0x18EA5AF9, "EB FE 00")) == refused
    assert sent(node, 0.1, (0x18EAFFF9, "EB FE 00")) == []
    assert sent(node, 0.1, (0x18EAFFF9, "00 EE 00"))[0][0] == "18EEFF5A"
    assert sent(node, 0.1, (0x18EA5AF9, "CB")) == []  # too short for a request


def test_the_address_is_defended_against_a_higher_name_and_left_to_a_lower_one() -> None:
    said: list[str] = []
    node = node_of(vehicle_of(DtcStore()), said)
    sent(node, 0.0)
    assert sent(node, 0.1, (0x18EEFF5A, "FF" * 8))[0][0] == "18EEFF5A"
    assert sent(node, 0.1, (0x18EEFF5A, "00" * 8))[0][0] == "18EEFFFE"
    assert sent(node, 5.0, (0x18EA5AF9, "CA FE 00")) == []
    assert said == ["J1939 address 5A belongs to another node; no DM1 is sent"]


IDENTIFIERS = sorted(node_of(vehicle_of(DtcStore())).identifiers)


@inputs(30)
@given(
    st.lists(st.tuples(st.sampled_from(IDENTIFIERS), st.binary(max_size=8)), max_size=20),
    st.lists(st.sampled_from(sorted(NUMBERS)), max_size=4, unique=True),
)
def test_whatever_comes_is_answered_with_whole_frames_of_its_own(
    received: list[tuple[tuple[int, bool], bytes]], faults: list[str]
) -> None:
    vehicle = vehicle_of(store_of(*faults))
    node = node_of(vehicle)
    frames = list(node.work(0.0))
    for k, ((can_id, _), data) in enumerate(received):
        node.receive(Frame(0, can_id, True, data))
        frames += node.work(0.1 * k)
    assert all(len(frame.data) == 8 for frame in frames)
    assert {frame.can_id & 0xFF for frame in frames} <= {OWN, 0xFE}


def test_every_fault_has_a_number() -> None:
    assert set(NUMBERS) == set(CODES)
    assert dm1(store_of("downstream_low", cycles=1))[2:6] == packed(3227, 4, 1)


def test_the_node_takes_few_filters_of_the_socket() -> None:
    node = node_of(vehicle_of(DtcStore()))
    assert len(node.identifiers) > 512  # more than a socket has
    identifiers, groups = filters([node])
    assert not identifiers
    assert groups == {(0x00EA0000, 0x03FF0000), (0x00EE0000, 0x03FF0000)}


@pytest.mark.parametrize("text", ["FE", "100", "-1", "engine"])
def test_an_address_that_no_node_has_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="an address from 00 to FD is wanted"):
        address(text)


def test_the_command_sends_dm1_under_its_address() -> None:
    with can.Bus(interface="virtual", channel="j1939 run") as tool:
        run = "run -i virtual --transmit --diagnostics-id none --j1939 5A --duration 1.6 --quiet"
        assert cli.main([*run.split(), "-c", "j1939 run"]) == 3
        heard = [message.arbitration_id for message in iter(lambda: tool.recv(0.0), None)]
    assert heard[0] == 0x18EEFF5A
    assert heard.count(0x18FECA5A) == 2
    without_transmit = "run -i virtual -c x --j1939 5A --duration 1"
    assert cli.main(without_transmit.split()) == 2
