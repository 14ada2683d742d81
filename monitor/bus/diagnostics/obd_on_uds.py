"""The data of SAE J1979 by identifiers of SAE J1979-2 (OBDonUDS), service 0x22.

0xF4xx are the parameters of $01, 0xF5xx those above 0xFF, 0xF6xx the monitors of $06 and 0xF8xx the
information of $09, each without the counts and repeated numbers of SAE J1979. The identifiers
0xF400, 0xF420 … list the supported ones as in $01. 0xF810 names the protocol. Scan tools ask for it
first, and speak to the whole vehicle as it says; so it is answered only if the user wants that.
"""

from collections.abc import Callable, Mapping
from typing import Final

from monitor.bus.diagnostics.obd import current_parameters, information, supported_tests
from monitor.bus.diagnostics.parameters import bitmap, encoded
from monitor.bus.diagnostics.results import monitors, test_results
from monitor.bus.diagnostics.state import State

PROTOCOL: Final = 0x10
OBD_ON_UDS: Final = b"\x01"  # SAE J1979-2


def _parameters(number: int, state: State) -> bytes | None:
    data = current_parameters(state) | encoded(state.values)
    known = {pid for pid in data if pid % 0x20}
    return bitmap(known, number) if number % 0x20 == 0 else data.get(number)


def _further_parameters(number: int, state: State) -> bytes | None:
    """Return that there are no parameters above 0xFF."""
    del state
    return bitmap((), number)


def _monitors(number: int, state: State) -> bytes | None:
    known = monitors(supported_tests(state))
    if number in known:
        return b"".join(row[1:] for row in test_results(number, state.store.results))
    return bitmap(known, number)


def _information(number: int, state: State) -> bytes | None:
    data = information(state) | ({PROTOCOL: OBD_ON_UDS} if state.is_obd_on_uds else {})
    return data[number] if number in data else bitmap(data, number)


# high byte of an identifier → data by its low byte
OBD_DATA: Final[Mapping[int, Callable[[int, State], bytes | None]]] = {
    0xF4: _parameters,
    0xF5: _further_parameters,
    0xF6: _monitors,
    0xF8: _information,
}
