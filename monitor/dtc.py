"""Diagnostic trouble codes: names, status byte, driving cycles.

A code becomes pending in the driving cycle in which its test fails, and confirmed in a later
driving cycle in which the test fails again. Sources: SAE J2012 (codes), ISO 14229-1 annex D
(status byte), 40 CFR 86.1806 and 13 CCR 1968.2 (two driving cycles, three to heal).
"""

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Literal

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
    "out_of_range": ("P2A00",),
    "signal_missing": ("U0100",),
    "signal_invalid": ("U0401",),
}
# test → the faults it can find
TESTS: dict[str, tuple[str, ...]] = {
    "response": tuple(
        name for name in CODES if name.startswith(("slow_", "delay_", "transient", "gain_"))
    ),
    "bias": ("biased_lean", "biased_rich"),
    "activity": ("stuck_lean", "stuck_rich", "stuck_at_one"),
    "communication": ("signal_missing", "signal_invalid"),
    "range": ("out_of_range",),
    "ready": ("not_ready",),
}
HEALING_CYCLES = 3


class Status(IntFlag):
    """Status byte of ISO 14229-1."""

    TEST_FAILED = 0x01
    FAILED_THIS_CYCLE = 0x02
    PENDING = 0x04
    CONFIRMED = 0x08
    NOT_COMPLETED_SINCE_CLEAR = 0x10
    FAILED_SINCE_CLEAR = 0x20
    NOT_COMPLETED_THIS_CYCLE = 0x40
    WARNING_INDICATOR = 0x80


FRESH = Status.NOT_COMPLETED_SINCE_CLEAR | Status.NOT_COMPLETED_THIS_CYCLE


@dataclass(frozen=True, slots=True)
class Dtc:
    """One trouble code and its history; every change gives a new value."""

    code: str
    fault: str = ""  # name of the fault that set it, "" if none did
    also: tuple[str, ...] = ()  # faults that cannot be told from it
    status: Status = FRESH
    t_ns: int = 0  # when it failed first in this driving cycle
    failed_before: bool = False  # in an earlier driving cycle
    passed_cycles: int = 0  # in a row, towards healing

    def fail(self, fault: str, also: tuple[str, ...], t_ns: int) -> "Dtc":
        """Return the code after its test has matured to failed."""
        first = not self.status & Status.FAILED_THIS_CYCLE
        status = self.status & ~FRESH | Status.TEST_FAILED | Status.FAILED_THIS_CYCLE
        status |= Status.PENDING | Status.FAILED_SINCE_CLEAR
        if self.failed_before:
            status |= Status.CONFIRMED | Status.WARNING_INDICATOR
        return replace(
            self,
            fault=fault,
            also=also,
            status=status,
            t_ns=t_ns if first else self.t_ns,
            passed_cycles=0,
        )

    def complete(self) -> "Dtc":
        """Return the code after its test has matured to passed."""
        return replace(self, status=self.status & ~FRESH & ~Status.TEST_FAILED)

    def next_cycle(self) -> "Dtc":
        """Return the code at the start of the next driving cycle."""
        completed = not self.status & Status.NOT_COMPLETED_THIS_CYCLE
        failed = bool(self.status & Status.FAILED_THIS_CYCLE)
        status = self.status & ~Status.FAILED_THIS_CYCLE & ~Status.TEST_FAILED
        status |= Status.NOT_COMPLETED_THIS_CYCLE
        passed_cycles = self.passed_cycles
        failed_before = self.failed_before or failed
        if completed and not failed:
            passed_cycles += 1
            failed_before = False
            status &= ~Status.PENDING
        if passed_cycles >= HEALING_CYCLES:
            status &= ~Status.WARNING_INDICATOR
        return replace(
            self, status=status, t_ns=0, failed_before=failed_before, passed_cycles=passed_cycles
        )

    @property
    def state(self) -> Literal["pending", "confirmed"] | None:
        """Return how far the code has matured."""
        if self.status & Status.CONFIRMED:
            return "confirmed"
        return "pending" if self.status & Status.PENDING else None


def _tests_of(code: str) -> set[str]:
    """Return the tests that can set a code."""
    return {test for test, faults in TESTS.items() if any(code in CODES[f] for f in faults)}


class DtcStore:
    """All codes of one monitor, in memory."""

    def __init__(self, dtcs: tuple[Dtc, ...] = ()) -> None:
        codes = sorted({code for group in CODES.values() for code in group})
        self._dtcs = {code: Dtc(code) for code in codes}
        self._dtcs |= {dtc.code: dtc for dtc in dtcs}
        self._passed: set[str] = set()  # tests that have passed in this driving cycle

    def fail(self, fault: str, t_ns: int, also: tuple[str, ...] = ()) -> list[Dtc]:
        """Set the codes of a fault; return those that changed."""
        return self._update({c: self._dtcs[c].fail(fault, also, t_ns) for c in CODES[fault]})

    def complete(self, test: str) -> list[Dtc]:
        """Note that a test has completed and passed; return what changed.

        A code that a fault of this test has set is complete; one that another test's fault has set
        keeps its status; one that was never set needs every test that can set it.
        """
        self._passed.add(test)
        faults = TESTS[test]
        codes = sorted({code for fault in faults for code in CODES[fault]})
        done = [c for c in codes if self._dtcs[c].fault in faults or self._is_clean(c)]
        return self._update({c: self._dtcs[c].complete() for c in done})

    def _is_clean(self, code: str) -> bool:
        return not self._dtcs[code].fault and self._passed >= _tests_of(code)

    def start_driving_cycle(self) -> None:
        """Begin the next driving cycle."""
        self._passed.clear()
        self._update({code: dtc.next_cycle() for code, dtc in self._dtcs.items()})

    def _update(self, new: dict[str, Dtc]) -> list[Dtc]:
        changed = [dtc for code, dtc in new.items() if dtc != self._dtcs[code]]
        self._dtcs |= new
        return changed

    @property
    def all(self) -> tuple[Dtc, ...]:
        """Return every code, also those that never failed."""
        return tuple(self._dtcs.values())

    @property
    def active(self) -> list[Dtc]:
        """Return the codes that are pending or confirmed, in the order of their failing."""
        return sorted((d for d in self.all if d.state), key=lambda d: (d.t_ns, d.code))

    @property
    def fault_flag(self) -> bool:
        """True when a code is pending or confirmed."""
        return any(d.state for d in self.all)
