"""Unified diagnostic services of ISO 14229-1: 0x10, 0x14, 0x19 and 0x3E."""

from collections.abc import Callable, Mapping
from typing import Final

from monitor.bus.diagnostics.obd import POSITIVE
from monitor.bus.diagnostics.reports import OUT_OF_RANGE, REPORTS
from monitor.bus.diagnostics.state import DEFAULT_SESSION, EXTENDED_SESSION, RefusedError, State

SUBFUNCTION_NOT_SUPPORTED: Final = 0x12
WRONG_LENGTH: Final = 0x13
PROGRAMMING_FAILURE: Final = 0x72
SERVICE_NOT_IN_SESSION: Final = 0x7F
SUPPRESS: Final = 0x80  # bit of the subfunction: send no positive response
TIMING: Final = bytes((0x00, 0x32, 0x01, 0xF4))  # P2 50 ms, P2* 5 s
GROUPS: Final = (0xFFFFFF, 0xFFFF33)  # all codes; codes of the emission system


def _session(request: bytes, state: State) -> bytes | None:
    """Answer 0x10: default or extended session."""
    subfunction, is_silent = _subfunction(request, 2)
    if subfunction not in (DEFAULT_SESSION, EXTENDED_SESSION):
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    state.session = subfunction
    return None if is_silent else bytes((request[0] + POSITIVE, subfunction)) + TIMING


def _tester_present(request: bytes, state: State) -> bytes | None:
    """Answer 0x3E, which keeps the session alive."""
    del state
    subfunction, is_silent = _subfunction(request, 2)
    if subfunction != 0:
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    return None if is_silent else bytes((request[0] + POSITIVE, 0))


def _clear(request: bytes, state: State) -> bytes:
    """Answer 0x14: clear the codes with the engine off, in the extended session."""
    if state.session != EXTENDED_SESSION:
        raise RefusedError(SERVICE_NOT_IN_SESSION)
    _check_length(request, 4)
    if int.from_bytes(request[1:], "big") not in GROUPS:
        raise RefusedError(OUT_OF_RANGE)
    state.try_to_clear(PROGRAMMING_FAILURE)
    return bytes((request[0] + POSITIVE,))


def _codes(request: bytes, state: State) -> bytes | None:
    """Answer 0x19: codes with status, freeze frames and counters."""
    subfunction, is_silent = _subfunction(request)
    report = REPORTS.get(subfunction)
    if report is None:
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    length, function = report
    _check_length(request, length)
    body = function(request[2:], state)
    return None if is_silent else bytes((request[0] + POSITIVE, subfunction)) + body


def _subfunction(request: bytes, length: int | None = None) -> tuple[int, bool]:
    """Return the subfunction, and whether a positive response is suppressed."""
    if len(request) < 2:
        raise RefusedError(WRONG_LENGTH)
    if length is not None:
        _check_length(request, length)
    return request[1] & ~SUPPRESS, bool(request[1] & SUPPRESS)


def _check_length(request: bytes, length: int) -> None:
    if len(request) != length:
        raise RefusedError(WRONG_LENGTH)


SERVICES: Final[Mapping[int, Callable[[bytes, State], bytes | None]]] = {
    0x10: _session,
    0x14: _clear,
    0x19: _codes,
    0x3E: _tester_present,
}
