"""Unified diagnostic services of ISO 14229-1: 0x10, 0x14, 0x19, 0x22, 0x27 and 0x3E."""

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from monitor.base.errors import O2Error
from monitor.bus.diagnostics.identifiers import IDENTIFIERS
from monitor.bus.diagnostics.obd import POSITIVE, current_parameters
from monitor.bus.diagnostics.parameters import encoded, unsigned
from monitor.bus.diagnostics.security import DENIED, security_access
from monitor.bus.diagnostics.state import DEFAULT_SESSION, EXTENDED_SESSION, RefusedError, State
from monitor.bus.transmit import dtc_number
from monitor.memory.codes import tests_of
from monitor.memory.dtc import Dtc, Status

SUBFUNCTION_NOT_SUPPORTED: Final = 0x12
WRONG_LENGTH: Final = 0x13
RESPONSE_TOO_LONG: Final = 0x14
OUT_OF_RANGE: Final = 0x31
PROGRAMMING_FAILURE: Final = 0x72
SERVICE_NOT_IN_SESSION: Final = 0x7F
SUPPRESS: Final = 0x80  # bit of the subfunction: send no positive response
TIMING: Final = bytes((0x00, 0x32, 0x01, 0xF4))  # P2 50 ms, P2* 5 s
GROUPS: Final = (0xFFFFFF, 0xFFFF33)  # all codes; codes of the emission system
STATUS_AVAILABLE: Final = 0xFF
DTC_FORMAT: Final = 0x00  # SAE J2012-DA: two bytes of code, one of failure type
FAILURE_TYPES: Final = {"U0100": 0x87, "U0401": 0x81}  # message missing; invalid data received
ALL_RECORDS: Final = 0xFF
SNAPSHOT: Final = 0x01  # record number
OBD_IDENTIFIERS: Final = 0xF400  # the low byte is a parameter of SAE J1979
MOST_IDENTIFIERS: Final = 16  # per request
LONGEST_ANSWER: Final = 512


def dtc_bytes(code: str) -> bytes:
    """Return a code as three bytes: two of SAE J2012, then the failure type.

    >>> dtc_bytes("P0133").hex(), dtc_bytes("U0100").hex()
    ('013300', 'c10087')
    """
    return unsigned(dtc_number(code), 2) + bytes((FAILURE_TYPES.get(code, 0x00),))


def _session(request: bytes, state: State) -> bytes | None:
    """Answer 0x10: default or extended session."""
    subfunction, is_silent = _subfunction(request, 2)
    if subfunction not in (DEFAULT_SESSION, EXTENDED_SESSION):
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    state.enter(subfunction)
    return None if is_silent else bytes((request[0] + POSITIVE, subfunction)) + TIMING


def _tester_present(request: bytes, state: State) -> bytes | None:
    """Answer 0x3E, which keeps the session alive."""
    del state
    subfunction, is_silent = _subfunction(request, 2)
    if subfunction != 0:
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    return None if is_silent else bytes((request[0] + POSITIVE, 0))


def _clear(request: bytes, state: State) -> bytes:
    """Answer 0x14: clear the codes, in the extended session with the engine off."""
    if state.session != EXTENDED_SESSION:
        raise RefusedError(SERVICE_NOT_IN_SESSION)
    if not state.access.is_open:
        raise RefusedError(DENIED)
    _check_length(request, 4)
    if int.from_bytes(request[1:], "big") not in GROUPS:
        raise RefusedError(OUT_OF_RANGE)
    state.check_may_clear()
    try:
        state.clear()
    except O2Error:
        raise RefusedError(PROGRAMMING_FAILURE) from None
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


def _count(mask: bytes, state: State) -> bytes:
    """Subfunction 0x01: number of codes with a status bit of the mask."""
    n_codes = sum(bool(d.status & mask[0]) for d in state.store.all)
    return bytes((STATUS_AVAILABLE, DTC_FORMAT)) + unsigned(n_codes, 2)


def _by_mask(mask: bytes, state: State) -> bytes:
    """Subfunction 0x02: codes with a status bit of the mask."""
    return _with_status(d for d in state.store.all if d.status & mask[0])


def _supported(_: bytes, state: State) -> bytes:
    """Subfunction 0x0A: all codes that can be set."""
    return _with_status(state.store.all)


def _with_status(dtcs: Iterable[Dtc]) -> bytes:
    rows = [dtc_bytes(d.code) + bytes((d.status,)) for d in dtcs]
    return bytes((STATUS_AVAILABLE,)) + b"".join(rows)


def _snapshot(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x04: the freeze frame of one code, as parameters under 0xF4xx."""
    dtc = _find(wanted, state)
    if wanted[3] not in (SNAPSHOT, ALL_RECORDS):
        raise RefusedError(OUT_OF_RANGE)
    frame = state.store.freeze_frames.get(dtc.code)
    record = b""
    if frame is not None:
        data = encoded(frame.values)
        rows = [unsigned(OBD_IDENTIFIERS + pid, 2) + item for pid, item in data.items()]
        record = bytes((SNAPSHOT, len(rows))) + b"".join(rows)
    return dtc_bytes(dtc.code) + bytes((dtc.status,)) + record


def _extended_data(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x06: counters of one code."""
    dtc = _find(wanted, state)
    records = _extended_records(dtc, state)
    if wanted[3] != ALL_RECORDS:
        if wanted[3] not in records:
            raise RefusedError(OUT_OF_RANGE)
        records = {wanted[3]: records[wanted[3]]}
    rows = [bytes((number,)) + data for number, data in records.items()]
    return dtc_bytes(dtc.code) + bytes((dtc.status,)) + b"".join(rows)


def _extended_records(dtc: Dtc, state: State) -> dict[int, bytes]:
    names = tests_of(dtc.code)
    ratios = [r for r in state.store.ratios if r.test in names]
    ratio = min(ratios, key=lambda r: (r.numerator, r.test), default=None)
    counters = (ratio.numerator, ratio.denominator) if ratio else (0, 0)
    failed_now = bool(dtc.status & Status.FAILED_THIS_CYCLE)
    return {
        0x01: unsigned(dtc.failed_cycles + failed_now, 1),
        0x02: unsigned(dtc.passed_cycles, 1),
        0x03: unsigned(dtc.warm_ups, 1),
        0x04: bytes((dtc.code in state.store.permanent,)),
        0x05: b"".join(unsigned(counter, 2) for counter in counters),
    }


def _find(wanted: bytes, state: State) -> Dtc:
    for dtc in state.store.all:
        if dtc_bytes(dtc.code) == wanted[:3]:
            return dtc
    raise RefusedError(OUT_OF_RANGE)


# subfunction of 0x19 → length of the request in bytes, function that makes the answer
REPORTS: Final[Mapping[int, tuple[int, Callable[[bytes, State], bytes]]]] = {
    0x01: (3, _count),
    0x02: (3, _by_mask),
    0x04: (6, _snapshot),
    0x06: (6, _extended_data),
    0x0A: (2, _supported),
}


def _read(request: bytes, state: State) -> bytes:
    """Answer 0x22: the values of up to 16 identifiers; unknown identifiers are left out."""
    if len(request) < 3 or len(request) % 2 == 0 or len(request) > 1 + 2 * MOST_IDENTIFIERS:
        raise RefusedError(WRONG_LENGTH)
    wanted = [request[i : i + 2] for i in range(1, len(request), 2)]
    items = [name + data for name in wanted if (data := _value(name, state)) is not None]
    if not items:
        raise RefusedError(OUT_OF_RANGE)
    answer = bytes((request[0] + POSITIVE,)) + b"".join(items)
    if len(answer) > LONGEST_ANSWER:
        raise RefusedError(RESPONSE_TOO_LONG)
    return answer


def _value(name: bytes, state: State) -> bytes | None:
    number = int.from_bytes(name, "big")
    if number & 0xFF00 == OBD_IDENTIFIERS:
        parameters = current_parameters(state) | encoded(state.values)
        return parameters.get(number & 0xFF)
    identifier = IDENTIFIERS.get(number)
    return None if identifier is None else identifier(state)


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
    0x22: _read,
    0x27: security_access,
    0x3E: _tester_present,
}
