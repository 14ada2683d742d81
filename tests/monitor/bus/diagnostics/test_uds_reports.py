"""Reports of UDS 0x19 and parameters of 0x22: requests of udsoncan, answers without a bus."""

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from udsoncan import Response
from udsoncan.services import ReadDTCInformation

from monitor.bus.diagnostics.server import answer
from monitor.bus.diagnostics.uds import REPORTS
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.store import Memory
from tests.helpers.bus.diagnostics_state import Vehicle, ask

Subfunction = ReadDTCInformation.Subfunction
SUBFUNCTIONS = sorted(v for k, v in vars(Subfunction).items() if k.startswith("report"))
ARGUMENTS: dict[str, Any] = {
    "status_mask": 0xFF,
    "severity_mask": 0xFF,
    "dtc": 0x013300,
    "snapshot_record_number": 0xFF,
    "extended_data_record_number": 0x05,
    "memory_selection": 1,
    "functional_group_id": 0x33,
}


def request_of(subfunction: int) -> bytes:
    """Return udsoncan's request; withdrawn subfunctions are those of older standards."""
    for version in (2020, 2013, 2006):
        try:
            request = ReadDTCInformation.make_request(
                subfunction, standard_version=version, **ARGUMENTS
            )
        except (NotImplementedError, ValueError):
            continue
        return bytes(request.get_payload())
    return bytes((0x19, subfunction))


@pytest.mark.parametrize("subfunction", SUBFUNCTIONS, ids=hex)
def test_every_report_of_codes_is_answered_or_refused(subfunction: int) -> None:
    found = answer(request_of(subfunction), False, Vehicle().state)
    assert found is not None
    if subfunction in REPORTS:
        assert found[:2] == bytes((0x59, subfunction))
    else:
        assert found == bytes((0x7F, 0x19, 0x12))


def test_a_code_keeps_the_freeze_frame_of_its_first_failure(tmp_path: Path) -> None:
    # GIVEN a code that failed at 1000 and again at 3000 rpm, stored and loaded again
    store = DtcStore()
    store.fail("slow_symmetric", 1)
    for t_ns, rpm in ((1, 1000.0), (2, 3000.0)):
        store.freeze(FreezeFrame("P0133", t_ns, {"engine_speed_rpm": rpm}))
    with closing(Memory(tmp_path / "o2.db")) as memory:
        memory.save(store.saved)
    with closing(Memory(tmp_path / "o2.db")) as memory:
        vehicle = Vehicle()
        vehicle.state.store = DtcStore(memory.load())
    # THEN UDS and J1979 read the first
    snapshot = Subfunction.reportDTCSnapshotRecordByDTCNumber
    response = Response.from_payload(answer(request_of(snapshot), False, vehicle.state) or b"")
    assert response.positive
    read = ReadDTCInformation.interpret_response(
        response, snapshot, dtc_snapshot_did_size=2, didconfig={"default": "2s"}
    )
    frames = {s.record_number: (s.did, s.raw_data) for s in read.service_data.dtcs[0].snapshots}
    assert frames == {0x00: (0xF40C, (4 * 1000).to_bytes(2, "big"))}
    assert (ask("02 0C 00", vehicle) or "").endswith("0f a0")
