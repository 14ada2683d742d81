"""Reports of UDS service 0x19 about codes (ISO 14229-1:2020)."""

from collections.abc import Callable, Mapping
from typing import Final

from monitor.bus.diagnostics.parameters import encoded, unsigned
from monitor.bus.diagnostics.state import RefusedError, State
from monitor.bus.transmit import dtc_number
from monitor.memory.codes import tests_of
from monitor.memory.dtc import Dtc, Status

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
    0x02: (3, _by_mask),
    0x04: (6, _snapshot),
    0x06: (6, _extended_data),
}
