"""The codes of the monitor as SAE J1939 codes: suspect parameter number (SPN), failure mode (FMI).

Sources: SAE J1939-73 (failure modes, layout of DM1 and DM2), SAE J1939-DA (numbers). Faults of one
kind share a code, because J1939 knows no direction of an edge.
"""

from collections.abc import Iterable
from typing import Final

from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import DtcStore

UPSTREAM: Final = 3217  # Engine Exhaust 1 Percent Oxygen 1
DOWNSTREAM: Final = 3227  # Aftertreatment 1 Outlet Percent Oxygen 1
CATALYST: Final = 3050  # Catalyst Bank 1 System Monitor
NETWORK: Final = 639  # J1939 Network #1
CONTROLLER: Final = 629  # Controller #1: the monitor itself

HIGH_VOLTAGE, LOW_VOLTAGE, OPEN_CIRCUIT, NOT_RESPONDING = 3, 4, 5, 7
ERRATIC, UPDATE_RATE, RATE_OF_CHANGE, BAD_DEVICE, CALIBRATION = 2, 9, 10, 12, 13
LEAST_LOW, NETWORK_DATA, DRIFTED_HIGH, DRIFTED_LOW, CONDITION = 17, 19, 20, 21, 31

# A lean sensor reads more oxygen than there is, so it has drifted high.
NUMBERS: Final[dict[str, tuple[int, int]]] = {
    **{f"slow_{edge}": (UPSTREAM, RATE_OF_CHANGE) for edge in ("rich_to_lean", "lean_to_rich")},
    **{f"delay_{edge}": (UPSTREAM, RATE_OF_CHANGE) for edge in ("rich_to_lean", "lean_to_rich")},
    "slow_symmetric": (UPSTREAM, RATE_OF_CHANGE),
    "delay_symmetric": (UPSTREAM, RATE_OF_CHANGE),
    "transient": (UPSTREAM, RATE_OF_CHANGE),
    "gain_low": (UPSTREAM, CALIBRATION),
    "biased_lean": (UPSTREAM, DRIFTED_HIGH),
    "biased_rich": (UPSTREAM, DRIFTED_LOW),
    "drift_lean": (UPSTREAM, DRIFTED_HIGH),
    "drift_rich": (UPSTREAM, DRIFTED_LOW),
    "balance_lean": (UPSTREAM, DRIFTED_HIGH),
    "balance_rich": (UPSTREAM, DRIFTED_LOW),
    "stuck_lean": (UPSTREAM, NOT_RESPONDING),
    "stuck_rich": (UPSTREAM, NOT_RESPONDING),
    "stuck_at_one": (UPSTREAM, NOT_RESPONDING),
    "no_activity": (UPSTREAM, NOT_RESPONDING),
    "not_ready": (UPSTREAM, BAD_DEVICE),
    "heater": (UPSTREAM, OPEN_CIRCUIT),
    "intermittent": (UPSTREAM, ERRATIC),
    "out_of_range": (UPSTREAM, ERRATIC),
    "signal_missing": (UPSTREAM, UPDATE_RATE),
    "signal_invalid": (UPSTREAM, NETWORK_DATA),
    "bus_off": (NETWORK, UPDATE_RATE),
    "memory_lost": (CONTROLLER, BAD_DEVICE),
    "catalyst_low": (CATALYST, LEAST_LOW),
    "downstream_weak": (DOWNSTREAM, CALIBRATION),
    "downstream_stuck_lean": (DOWNSTREAM, NOT_RESPONDING),
    "downstream_stuck_rich": (DOWNSTREAM, NOT_RESPONDING),
    "downstream_low": (DOWNSTREAM, LOW_VOLTAGE),
    "downstream_high": (DOWNSTREAM, HIGH_VOLTAGE),
    "downstream_inactive": (DOWNSTREAM, OPEN_CIRCUIT),
    "downstream_heater": (DOWNSTREAM, OPEN_CIRCUIT),
    **{
        f"downstream_{kind}_{edge}": (DOWNSTREAM, RATE_OF_CHANGE)
        for kind in ("slow", "delay")
        for edge in ("rich_to_lean", "lean_to_rich", "symmetric")
    },
}
OTHER: Final = UPSTREAM, CONDITION  # of the fault of a plug-in
MOST_COUNTED: Final = 126  # 127 means not available
LAMP_ON, LAMP_OFF = 0x7F, 0x3F  # malfunction indicator lamp; the other lamps are not available
NO_FLASH: Final = 0xFF
NO_CODE: Final = bytes((0, 0, 0, 0, 0xFF, 0xFF))


def dm1(store: DtcStore) -> bytes:
    """Return lamp and active codes: those whose test failed when it was last completed."""
    return _message(store, (d for d in store.active if d.status & Status.TEST_FAILED))


def dm2(store: DtcStore) -> bytes:
    """Return lamp and previously active codes: confirmed ones whose test does not fail now."""
    return _message(store, previously_active(store))


def previously_active(store: DtcStore) -> list[Dtc]:
    """Return the confirmed codes whose test does not fail now."""
    return [d for d in store.active if d.state == "confirmed" and not _is_active(d)]


def has_active(store: DtcStore) -> bool:
    """Return whether a test fails now."""
    return any(_is_active(d) for d in store.active)


def _is_active(dtc: Dtc) -> bool:
    return bool(dtc.status & Status.TEST_FAILED)


def _message(store: DtcStore, dtcs: Iterable[Dtc]) -> bytes:
    counted: dict[tuple[int, int], int] = {}
    for dtc in dtcs:
        number = NUMBERS.get(dtc.fault, OTHER)
        failed = dtc.failed_cycles + bool(dtc.status & Status.FAILED_THIS_CYCLE)
        counted[number] = max(counted.get(number, 0), failed)
    codes = b"".join(packed(spn, fmi, n) for (spn, fmi), n in counted.items())
    lamps = bytes((LAMP_ON if store.mil else LAMP_OFF, NO_FLASH))
    return (lamps + (codes or NO_CODE)).ljust(8, b"\xff")


def packed(spn: int, fmi: int, count: int) -> bytes:
    """Return a code in four bytes, conversion method 0.

    >>> packed(3217, 10, 2).hex(" ")
    '91 0c 0a 02'
    """
    number = spn & 0xFFFF | (spn >> 16 & 7) << 21 | (fmi & 0x1F) << 16
    return (number | min(count, MOST_COUNTED) << 24).to_bytes(4, "little")
