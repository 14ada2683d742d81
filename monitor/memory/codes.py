"""The trouble codes of each fault, and the test that finds it. Source of the codes: SAE J2012."""

import re
from collections.abc import Mapping
from typing import Final

from monitor.base.errors import ConfigError

CODES: dict[str, tuple[str, ...]] = {
    "slow_rich_to_lean": ("P014C",),
    "slow_lean_to_rich": ("P014D",),
    "slow_symmetric": ("P0133",),
    "delay_rich_to_lean": ("P015A",),
    "delay_lean_to_rich": ("P015B",),
    "delay_symmetric": ("P015A", "P015B"),
    "transient": ("P0133",),
    "gain_low": ("P2A00",),
    "biased_lean": ("P2195",),
    "biased_rich": ("P2196",),
    "stuck_lean": ("P2195",),
    "stuck_rich": ("P2196",),
    "stuck_at_one": ("P0134",),
    "not_ready": ("P0134",),
    "heater": ("P0135",),
    "no_activity": ("P0134",),
    "intermittent": ("P2A00",),
    "drift_lean": ("P2195",),
    "drift_rich": ("P2196",),
    "out_of_range": ("P2A00",),
    "signal_missing": ("U0100",),
    "signal_invalid": ("U0401",),
    "bus_off": ("U0001",),  # the monitor itself is off the bus, so no sender is blamed
    "memory_lost": ("P062F",),
    "catalyst_low": ("P0420",),
    "downstream_slow_rich_to_lean": ("P013A",),
    "downstream_slow_lean_to_rich": ("P013B",),
    "downstream_slow_symmetric": ("P013A", "P013B"),
    "downstream_delay_rich_to_lean": ("P013E",),
    "downstream_delay_lean_to_rich": ("P013F",),
    "downstream_delay_symmetric": ("P013E", "P013F"),
    "downstream_weak": ("P2A01",),
    "downstream_stuck_lean": ("P2270",),
    "downstream_stuck_rich": ("P2271",),
    "downstream_low": ("P0137",),
    "downstream_high": ("P0138",),
    "downstream_inactive": ("P0140",),
    "downstream_heater": ("P0141",),
    "balance_lean": ("P2096",),
    "balance_rich": ("P2097",),
}
# Codes of a catalyst that is judged by itself close to the engine, before another one.
CLOSE_COUPLED: Final = {"catalyst_low": ("P0421",)}
_CIRCUIT: Final = ("downstream_low", "downstream_high", "downstream_inactive")
_HEATER: Final = "downstream_heater"
LOST: Final = "memory_lost"  # the fault memory was damaged and begun anew
# Faults of the monitor, not of the vehicle: they never set the fault flag, see ``DtcStore``.
OF_MONITOR: Final = frozenset({LOST})
# test → faults that it can find
TESTS: dict[str, tuple[str, ...]] = {
    "response": tuple(
        name
        for name in CODES
        if name.startswith(("slow_", "delay_", "transient", "gain_", "no_activity", "intermittent"))
    ),
    "bias": ("biased_lean", "biased_rich", "drift_lean", "drift_rich"),
    "activity": ("stuck_lean", "stuck_rich", "stuck_at_one"),
    "communication": ("signal_missing", "signal_invalid", "bus_off"),
    "range": ("out_of_range",),
    "ready": ("not_ready", "heater"),
    "memory": (LOST,),
    "catalyst": ("catalyst_low",),
    "downstream": tuple(
        name
        for name in CODES
        if name.startswith("downstream_") and name not in (*_CIRCUIT, _HEATER)
    ),
    "downstream_circuit": _CIRCUIT,
    "downstream_heater": (_HEATER,),
    "balance": ("balance_lean", "balance_rich"),
}
# tests of vehicles with a downstream sensor, for which signals or drives may be missing
BEHIND: Final = ("catalyst", "downstream", "downstream_circuit", "downstream_heater", "balance")
# Tests of the vehicle; the monitor's own has no in-use performance ratio and decides at once.
OF_VEHICLE: Final = tuple(test for test in TESTS if test != "memory")
# Tests that judge every sample; they have no in-use performance ratio (13 CCR 1968.2 (d)(3.2)).
CONTINUOUS = ("communication", "range", "ready")
TEST_OF: dict[str, str] = {fault: test for test, faults in TESTS.items() for fault in faults}


def codes_of(fault: str) -> tuple[str, ...]:
    """Return all codes that a fault may set, on one vehicle or another."""
    return CODES[fault] + CLOSE_COUPLED.get(fault, ())


def codes_on(fault: str, *, close_coupled: bool) -> tuple[str, ...]:
    """Return the codes that a fault sets on a vehicle.

    close_coupled : the judged catalyst is one close to the engine, before another one
    """
    return CLOSE_COUPLED.get(fault, CODES[fault]) if close_coupled else CODES[fault]


_MANUFACTURERS: Final = re.compile("P1[0-9A-F]{3}")  # free for a manufacturer, SAE J2012


def every() -> tuple[str, ...]:
    """Return all codes, those of plug-ins included."""
    return tuple(sorted({code for fault in CODES for code in codes_of(fault)}))


def is_known(code: str) -> bool:
    """Return whether a stored code can be one of the monitor or of a plug-in."""
    return code in every() or bool(_MANUFACTURERS.fullmatch(code))


def admit(test: str, faults: Mapping[str, str]) -> None:
    """Add the test of a plug-in, with the code of each of its faults.

    Raises ConfigError if a name is taken or a code is not one of the manufacturer's.
    """
    own = {fault: (code,) for fault, code in faults.items()}
    if TESTS.get(test) == tuple(own) and all(CODES[fault] == own[fault] for fault in own):
        return
    taken = [name for name in (test, *own) if name in TESTS or name in CODES]
    if taken or not own:
        raise ConfigError(f"the name {taken[0]} is taken" if taken else "it has no fault")
    for fault, code in faults.items():
        if not _MANUFACTURERS.fullmatch(code) or code in every():
            raise ConfigError(f"{code} of {fault}: a new code from P1000 to P1FFF is wanted")
    CODES.update(own)
    TESTS[test] = tuple(own)
    TEST_OF.update(dict.fromkeys(own, test))


def tests_of(code: str) -> set[str]:
    """Return the tests that can set a code."""
    return {test for test, faults in TESTS.items() if any(code in codes_of(f) for f in faults)}
