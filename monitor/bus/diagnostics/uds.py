"""Unified diagnostic services of ISO 14229-1:2020: 0x10, 0x14, 0x19 and 0x3E."""

from collections.abc import Callable, Mapping
from typing import Final

from monitor.bus.diagnostics.obd import POSITIVE
from monitor.bus.diagnostics.parameters import encoded, unsigned
from monitor.bus.diagnostics.state import DEFAULT_SESSION, EXTENDED_SESSION, RefusedError, State
from monitor.bus.transmit import dtc_number
from monitor.memory.codes import tests_of
from monitor.memory.dtc import Dtc

SUBFUNCTION_NOT_SUPPORTED: Final = 0x12
WRONG_LENGTH: Final = 0x13
PROGRAMMING_FAILURE: Final = 0x72
SERVICE_NOT_IN_SESSION: Final = 0x7F
SUPPRESS: Final = 0x80  # bit of the subfunction: send no positive response
TIMING: Final = bytes((0x00, 0x32, 0x01, 0xF4))  # P2 50 ms, P2* 5 s
GROUPS: Final = (0xFFFFFF, 0xFFFF33)  # all codes; codes of the emission system
OUT_OF_RANGE: Final = 0x31
STATUS_AVAILABLE: Final = 0xFF
FAILURE_TYPES: Final = {"U0100": 0x87, "U0401": 0x81}  # message missing; invalid data received
ALL_RECORDS: Final = 0xFF
FIRST, SNAPSHOT = 0x00, 0x01  # numbers of the only snapshot record
PARAMETERS_FROM: Final = 0xF400  # the low byte is a parameter of SAE J1979


def dtc_bytes(code: str) -> bytes:
    """Return a code as three bytes: two of SAE J2012, then the failure type.

    >>> dtc_bytes("P0133").hex(), dtc_bytes("U0100").hex()
    ('013300', 'c10087')
    """
    return unsigned(dtc_number(code), 2) + bytes((FAILURE_TYPES.get(code, 0x00),))


def _by_mask(mask: bytes, state: State) -> bytes:
    """Subfunction 0x02: codes with a status bit of the mask."""
    rows = [dtc_bytes(d.code) + bytes((d.status,)) for d in state.store.all if d.status & mask[0]]
    return bytes((STATUS_AVAILABLE,)) + b"".join(rows)


def _snapshot(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x04: the freeze frame of one code, as parameters under 0xF4xx."""
    dtc, number = _find(wanted, state), wanted[3]
    if number not in (FIRST, SNAPSHOT, ALL_RECORDS):
        raise RefusedError(OUT_OF_RANGE)
    told = dtc_bytes(dtc.code) + bytes((dtc.status,))
    frame = state.store.freeze_frames.get(dtc.code)
    if frame is None:
        return told
    data = encoded(frame.values)
    rows = [unsigned(PARAMETERS_FROM + pid, 2) + item for pid, item in data.items()]
    own = FIRST if number == ALL_RECORDS else number
    return told + bytes((own, len(rows))) + b"".join(rows)


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
    return {
        0x01: unsigned(dtc.failed_cycles + dtc.has_failed, 1),
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
    0x02: (3, _by_mask),
    0x04: (6, _snapshot),
    0x06: (6, _extended_data),
}


def _session(request: bytes, state: State) -> bytes:
    """Answer 0x10: default or extended session."""
    _check_length(request, 2)
    if request[1] not in (DEFAULT_SESSION, EXTENDED_SESSION):
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    state.session = request[1]
    return TIMING


def _tester_present(request: bytes, _: State) -> bytes:
    """Answer 0x3E, which keeps the session alive."""
    _check_length(request, 2)
    if request[1] != 0:
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    return b""


def _clear(request: bytes, state: State) -> bytes:
    """Answer 0x14: clear the codes with the engine off, in the extended session."""
    if state.session != EXTENDED_SESSION:
        raise RefusedError(SERVICE_NOT_IN_SESSION)
    _check_length(request, 4)
    if int.from_bytes(request[1:], "big") not in GROUPS:
        raise RefusedError(OUT_OF_RANGE)
    state.try_to_clear(PROGRAMMING_FAILURE)
    return bytes((request[0] + POSITIVE,))


def _codes(request: bytes, state: State) -> bytes:
    """Answer 0x19: codes with status, freeze frames and counters."""
    if request[1] not in REPORTS:
        raise RefusedError(SUBFUNCTION_NOT_SUPPORTED)
    length, report = REPORTS[request[1]]
    _check_length(request, length)
    return report(request[2:], state)


def _check_length(request: bytes, length: int) -> None:
    if len(request) != length:
        raise RefusedError(WRONG_LENGTH)


def _with_subfunction(
    body_of: Callable[[bytes, State], bytes],
) -> Callable[[bytes, State], bytes | None]:
    """Return a service whose second byte is a subfunction, and may suppress the answer.

    body_of : takes the request without the bit that suppresses; returns the bytes behind the
        subfunction
    """

    def answer(request: bytes, state: State) -> bytes | None:
        if len(request) < 2:
            raise RefusedError(WRONG_LENGTH)
        subfunction = request[1] & ~SUPPRESS
        body = body_of(bytes((request[0], subfunction)) + request[2:], state)
        is_silent = request[1] & SUPPRESS
        return None if is_silent else bytes((request[0] + POSITIVE, subfunction)) + body

    return answer


SERVICES: Final[Mapping[int, Callable[[bytes, State], bytes | None]]] = {
    0x10: _with_subfunction(_session),
    0x14: _clear,
    0x19: _with_subfunction(_codes),
    0x3E: _with_subfunction(_tester_present),
}
