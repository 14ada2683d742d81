"""On-board diagnostics: services $01 to $0A of SAE J1979 (ISO 15031-5) on CAN."""

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from monitor.bus.diagnostics.parameters import bitmaps, encoded, unsigned
from monitor.bus.diagnostics.results import monitors, test_results
from monitor.bus.diagnostics.state import RefusedError, State
from monitor.bus.transmit import dtc_number
from monitor.memory.dtc import Status
from monitor.memory.obd_records import Ratio

POSITIVE: Final = 0x40  # added to the service's number
NOT_SUPPORTED: Final = 0x12  # subfunction not supported, or invalid format
CONDITIONS_NOT_CORRECT: Final = 0x22
STANDARDS: Final = {"carb": 0x01, "eobd": 0x06}  # PID 1C: OBD II (CARB), EOBD
MOST_NUMBERS: Final = 6  # parameters, monitors or kinds of information per request
SENSOR_TESTS: Final = ("response", "bias", "activity")  # tests of the oxygen sensor monitor
COMPONENTS: Final = 0x04  # byte B of PIDs 01 and 41: comprehensive components, continuous
# bit of bytes C and D → tests; those behind the catalyst count where the vehicle supports them
READINESS: Final = {
    0x01: ("catalyst",),
    0x20: (*SENSOR_TESTS, "downstream", "balance"),  # oxygen sensors, before and behind it
    0x40: ("downstream_heater",),
}
# place of numerator and denominator among the counters → tests
IN_USE: Final = {2: ("catalyst",), 6: SENSOR_TESTS, 16: ("downstream", "downstream_heater")}
ECU_NAME: Final = b"O2M\0-OxygenMonitor\0\0"  # acronym, delimiter, name: 20 bytes


def _current(request: bytes, state: State) -> bytes:
    """Answer service $01: up to six parameters."""
    counts = state.store.counts
    data = {
        0x01: readiness(state),
        0x1C: bytes((STANDARDS[state.identity.profile],)),
        0x21: unsigned(counts.distance_with_mil_km, 2),
        0x30: unsigned(counts.warm_ups_since_clear, 1),
        0x31: unsigned(counts.distance_since_clear_km, 2),
        0x41: bytes((0, COMPONENTS, *_readiness(state, state.store.completed_this_cycle))),
        0x4D: unsigned(counts.engine_run_with_mil_s / 60.0, 2),
        0x4E: unsigned(counts.engine_run_since_clear_s / 60.0, 2),
    }
    return _listed(request, bitmaps(data) | data)


def readiness(state: State) -> bytes:
    """Return PID 01: lamp, number of confirmed codes, and completed monitors."""
    n_codes = sum(bool(d.status & Status.CONFIRMED) for d in state.store.all)
    supported, missing = _readiness(state, state.store.completed_since_clear)
    return bytes((state.store.mil << 7 | n_codes, COMPONENTS, supported, missing))


def _readiness(state: State, is_done: Callable[[str], bool]) -> tuple[int, int]:
    """Return which groups of tests are supported, and which of them are not complete."""
    known = supported_tests(state)
    groups = {bit: [t for t in tests if t in known] for bit, tests in READINESS.items()}
    supported = sum(bit for bit, tests in groups.items() if tests)
    missing = sum(bit for bit, tests in groups.items() if not all(map(is_done, tests)))
    return supported, missing


def supported_tests(state: State) -> set[str]:
    """Return the tests that this vehicle is known to support."""
    return {ratio.test for ratio in state.store.supported_ratios}


def _freeze_frame(request: bytes, state: State) -> bytes:
    """Answer service $02: up to three pairs of parameter and frame number; only frame 0 exists."""
    pairs = request[1:]
    if len(pairs) % 2 or not 0 < len(pairs) <= MOST_NUMBERS:
        raise RefusedError(NOT_SUPPORTED)
    frame = next(iter(state.store.freeze_frames.values()), None)
    code = dtc_number(frame.code) if frame else 0
    data = {0x02: unsigned(code, 2)} | encoded(frame.values if frame else {})
    data |= bitmaps(data)
    items = [
        bytes((pid, number)) + data[pid]
        for pid, number in zip(pairs[::2], pairs[1::2], strict=True)
        if pid in data and number == 0
    ]
    return _positive(request, items)


def _codes(pick: Callable[[State], Iterable[str]]) -> Callable[[bytes, State], bytes]:
    """Return the answer to services $03, $07 and $0A: the codes that ``pick`` gives."""

    def answer(request: bytes, state: State) -> bytes:
        _check_alone(request)
        numbers = [unsigned(dtc_number(code), 2) for code in pick(state)]
        return bytes((request[0] + POSITIVE, len(numbers))) + b"".join(numbers)

    return answer


def _with(status: Status) -> Callable[[State], Iterable[str]]:
    return lambda state: (dtc.code for dtc in state.store.all if dtc.status & status)


def _clear(request: bytes, state: State) -> bytes:
    """Answer service $04."""
    _check_alone(request)
    state.try_to_clear(CONDITIONS_NOT_CORRECT)
    return bytes((request[0] + POSITIVE,))


def _test_results(request: bytes, state: State) -> bytes:
    """Answer service $06: up to six support requests, or the results of one monitor."""
    numbers = request[1:]
    known = monitors(supported_tests(state))
    if len(numbers) == 1 and numbers[0] in known:
        return _positive(request, test_results(numbers[0], state.store.results))
    return _listed(request, bitmaps(known))


def _vehicle_information(request: bytes, state: State) -> bytes:
    """Answer service $09: up to six support requests, or one kind of information."""
    known = information(state)
    data = {number: b"\x01" + item for number, item in known.items()}
    data[0x08] = bytes((len(known[0x08]) // 2,)) + known[0x08]
    if len(request) == 2 and request[1] in data:
        return _positive(request, [request[1:] + data[request[1]]])
    return _listed(request, bitmaps(data))


def information(state: State) -> dict[int, bytes]:
    """Return the kinds of information of service $09, without their counts."""
    identity = state.identity
    known = {
        0x04: identity.calibration_id.encode().ljust(16, b"\0"),
        0x06: bytes.fromhex(identity.model_sha256[:8]),
        0x08: in_use_performance(state),
        0x0A: ECU_NAME,
    }
    return known | ({0x02: identity.vin.encode()} if identity.vin else {})


def in_use_performance(state: State) -> bytes:
    """Return the 20 counters of spark ignition, of bank 1; cycles begin anew behind 65,535.

    Used are those of the catalyst, of the oxygen sensor and of the one behind the catalyst.
    """
    counts = state.store.counts
    counters = [counts.general_denominator % 0x10000, counts.ignition_cycles % 0x10000] + [0] * 18
    for at, tests in IN_USE.items():
        ratio = lowest_ratio(r for r in state.store.supported_ratios if r.test in tests)
        counters[at : at + 2] = ratio.numerator, ratio.denominator
    return b"".join(unsigned(counter, 2) for counter in counters)


def lowest_ratio(ratios: Iterable[Ratio]) -> Ratio:
    """Return the lowest ratio; among equal ones that with the highest denominator.

    >>> lowest_ratio([Ratio("response", 1, 2), Ratio("bias", 2, 4), Ratio("activity", 3, 4)]).test
    'bias'
    """
    return min(
        ratios,
        key=lambda r: (r.numerator / r.denominator if r.denominator else 1.0, -r.denominator),
        default=Ratio("", 0, 0),
    )


def _listed(request: bytes, data: Mapping[int, bytes]) -> bytes:
    """Return the answer with the available ones of the requested numbers."""
    numbers = request[1:]
    if not 0 < len(numbers) <= MOST_NUMBERS:
        raise RefusedError(NOT_SUPPORTED)
    return _positive(request, [bytes((n,)) + data[n] for n in numbers if n in data])


def _positive(request: bytes, parts: list[bytes]) -> bytes:
    if not parts:
        raise RefusedError(NOT_SUPPORTED)
    return bytes((request[0] + POSITIVE,)) + b"".join(parts)


def _check_alone(request: bytes) -> None:
    """Raise RefusedError if bytes follow the service number."""
    if len(request) != 1:
        raise RefusedError(NOT_SUPPORTED)


SERVICES: Final[Mapping[int, Callable[[bytes, State], bytes]]] = {
    0x01: _current,
    0x02: _freeze_frame,
    0x03: _codes(_with(Status.CONFIRMED)),
    0x04: _clear,
    0x06: _test_results,
    0x07: _codes(_with(Status.PENDING)),
    0x09: _vehicle_information,
    0x0A: _codes(lambda state: state.store.permanent),
}
