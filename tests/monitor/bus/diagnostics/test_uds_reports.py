"""Reports of UDS 0x19 and parameters of 0x22: requests of udsoncan, answers without a bus."""

from typing import Any

import pytest
from udsoncan.services import ReadDTCInformation

from monitor.bus.diagnostics.server import answer
from monitor.bus.diagnostics.uds import REPORTS
from tests.helpers.bus.diagnostics_state import Vehicle

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
