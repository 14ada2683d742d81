"""Reports of UDS service 0x19 about codes: ISO 14229-1:2020, and SAE J1979-2 (OBDonUDS)."""

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from monitor.bus.diagnostics.obd import READINESS
from monitor.bus.diagnostics.parameters import encoded, unsigned
from monitor.bus.diagnostics.state import RefusedError, State
from monitor.bus.transmit import dtc_number
from monitor.memory.codes import tests_of
from monitor.memory.dtc import Dtc, Status
from monitor.memory.obd_records import FreezeFrame

OUT_OF_RANGE: Final = 0x31
STATUS_AVAILABLE: Final = 0xFF
DTC_FORMAT: Final = 0x00  # SAE J2012-DA: two bytes of code, one of failure type
OBD_FORMAT: Final = 0x04  # the same three bytes, as SAE J1979-2 names them
FAILURE_TYPES: Final = {"U0100": 0x87, "U0401": 0x81}  # message missing; invalid data received
ALL_RECORDS, OBD_RECORDS = 0xFF, 0xFE
FIRST, LATEST = 0x00, 0xF0  # snapshot records of SAE J1979-2: first and latest failure
SNAPSHOT: Final = 0x01  # another number of the first
IN_USE_RATIO: Final = 0x91  # extended data record of SAE J1979-2: numerator and denominator
PARAMETERS_FROM: Final = 0xF400  # the low byte is a parameter of SAE J1979
OBD_GROUP: Final = 0x33  # functional group: emission system
SEVERITY: Final = 0x22  # maintenance only, class 1 (ISO 14229-1, annex D.3)
# Readiness group → tests: 1 + the place of the bit in PID 01, byte C.
READINESS_GROUPS: Final = {bit.bit_length(): tests for bit, tests in READINESS.items()}


def dtc_bytes(code: str) -> bytes:
    """Return a code as three bytes: two of SAE J2012, then the failure type.

    >>> dtc_bytes("P0133").hex(), dtc_bytes("U0100").hex()
    ('013300', 'c10087')
    """
    return unsigned(dtc_number(code), 2) + bytes((FAILURE_TYPES.get(code, 0x00),))


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


def _snapshot_identification(_: bytes, state: State) -> bytes:
    """Subfunction 0x03: codes with the numbers of their snapshot records."""
    rows = [
        dtc_bytes(d.code) + bytes((number,))
        for d in state.store.all
        for number in _frames(d, state)
    ]
    return b"".join(rows)


def _snapshot(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x04: the freeze frames of one code, as parameters under 0xF4xx."""
    dtc = _find(wanted, state)
    frames = _frames(dtc, state)
    if wanted[3] != ALL_RECORDS:
        if wanted[3] not in (FIRST, LATEST, SNAPSHOT):
            raise RefusedError(OUT_OF_RANGE)
        kept = FIRST if wanted[3] == SNAPSHOT else wanted[3]
        frames = {wanted[3]: frames[kept]} if kept in frames else {}
    records = [bytes((number,)) + _record(frame) for number, frame in frames.items()]
    return dtc_bytes(dtc.code) + bytes((dtc.status,)) + b"".join(records)


def _frames(dtc: Dtc, state: State) -> dict[int, FreezeFrame]:
    """Return the freeze frames of a code by their record numbers in SAE J1979-2."""
    kept = {FIRST: state.store.freeze_frames, LATEST: state.store.latest_frames}
    return {number: frames[dtc.code] for number, frames in kept.items() if dtc.code in frames}


def _record(frame: FreezeFrame) -> bytes:
    data = encoded(frame.values)
    rows = [unsigned(PARAMETERS_FROM + pid, 2) + item for pid, item in data.items()]
    return bytes((len(rows),)) + b"".join(rows)


def _extended_data(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x06: counters of one code."""
    dtc = _find(wanted, state)
    records = _extended_records(dtc, state)
    if wanted[3] == OBD_RECORDS:
        records = {IN_USE_RATIO: records[IN_USE_RATIO]}
    elif wanted[3] != ALL_RECORDS:
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
    counts = b"".join(unsigned(counter, 2) for counter in counters)
    return {
        0x01: unsigned(dtc.failed_cycles + failed_now, 1),
        0x02: unsigned(dtc.passed_cycles, 1),
        0x03: unsigned(dtc.warm_ups, 1),
        0x04: bytes((dtc.code in state.store.permanent,)),
        0x05: counts,
        IN_USE_RATIO: counts,
    }


def _find(wanted: bytes, state: State) -> Dtc:
    for dtc in state.store.all:
        if dtc_bytes(dtc.code) == wanted[:3]:
            return dtc
    raise RefusedError(OUT_OF_RANGE)


def _fault_detection_counters(_: bytes, state: State) -> bytes:
    """Subfunction 0x14: codes that are about to fail, with their counters from 1 to 126."""
    rows = [dtc_bytes(code) + bytes((n,)) for code, n in state.prefailed().items() if 0 < n < 127]
    return b"".join(rows)


def _permanent(_: bytes, state: State) -> bytes:
    """Subfunction 0x15: codes with permanent status."""
    return _with_status(_permanent_codes(state))


def _permanent_codes(state: State) -> list[Dtc]:
    codes = {d.code: d for d in state.store.all}
    return [codes[code] for code in state.store.permanent if code in codes]


def _with_record(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x1A: codes that have an extended data record."""
    number = wanted[0]
    dtcs = state.store.all
    if not dtcs or number not in _extended_records(dtcs[0], state):  # each code has all of them
        raise RefusedError(OUT_OF_RANGE)
    rows = [dtc_bytes(d.code) + bytes((d.status,)) for d in dtcs]
    return bytes((STATUS_AVAILABLE, number)) + b"".join(rows)


def _obd_by_mask(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x42: codes of the emission system by status and severity."""
    _check_group(wanted[0])
    dtcs = [d for d in state.store.all if d.status & wanted[1] and wanted[2] & SEVERITY]
    rows = [bytes((SEVERITY,)) + dtc_bytes(d.code) + bytes((d.status,)) for d in dtcs]
    return bytes((OBD_GROUP, STATUS_AVAILABLE, SEVERITY, OBD_FORMAT)) + b"".join(rows)


def _obd_permanent(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x55: permanent codes of the emission system."""
    _check_group(wanted[0])
    head = bytes((OBD_GROUP, STATUS_AVAILABLE, OBD_FORMAT))
    rows = [dtc_bytes(d.code) + bytes((d.status,)) for d in _permanent_codes(state)]
    return head + b"".join(rows)


def _obd_group(wanted: bytes, state: State) -> bytes:
    """Subfunction 0x56: the codes of a readiness group, whose status says if each is ready."""
    _check_group(wanted[0])
    if wanted[1] not in READINESS_GROUPS:
        raise RefusedError(OUT_OF_RANGE)
    tests = READINESS_GROUPS[wanted[1]]
    dtcs = [d for d in state.store.all if tests_of(d.code).intersection(tests)]
    head = bytes((OBD_GROUP, STATUS_AVAILABLE, OBD_FORMAT, wanted[1]))
    return head + b"".join(dtc_bytes(d.code) + bytes((d.status,)) for d in dtcs)


def _check_group(group: int) -> None:
    if group != OBD_GROUP:
        raise RefusedError(OUT_OF_RANGE)


# subfunction of 0x19 → length of the request in bytes, function that makes the answer
REPORTS: Final[Mapping[int, tuple[int, Callable[[bytes, State], bytes]]]] = {
    0x01: (3, _count),
    0x02: (3, _by_mask),
    0x03: (2, _snapshot_identification),
    0x04: (6, _snapshot),
    0x06: (6, _extended_data),
    0x0A: (2, _supported),
    0x14: (2, _fault_detection_counters),
    0x15: (2, _permanent),
    0x1A: (3, _with_record),
    0x42: (5, _obd_by_mask),
    0x55: (3, _obd_permanent),
    0x56: (4, _obd_group),
}
