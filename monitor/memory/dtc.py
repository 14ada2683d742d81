"""Diagnostic trouble codes (DTCs): the status byte of one code from driving cycle to driving cycle.

A code becomes pending in the driving cycle in which its test fails. It becomes confirmed, with the
lamp on, in a later driving cycle in which the test fails again. Sources: ISO 14229-1 annex D
(status byte), 13 CCR 1968.2 (d)(2) and (d)(4), 40 CFR 86.1806, UN R83 annex 11. The configuration
holds the numbers of cycles per regulation.
"""

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Literal

from monitor.base.config import ProfileConfig


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
    """One trouble code and its history, immutable."""

    code: str
    fault: str = ""  # fault that set the code; "" if it was never set
    also: tuple[str, ...] = ()  # faults that cannot be told apart from it
    status: Status = FRESH
    t_ns: int = 0  # time of the first failure in this driving cycle
    failed_cycles: int = 0  # earlier driving cycles with a failure, since the last that passed
    passed_cycles: int = 0  # passed driving cycles in a row; enough of them turn the lamp off
    warm_ups: int = 0  # warm-up cycles since the lamp went off; enough of them erase the code

    def fail(self, fault: str, also: tuple[str, ...], t_ns: int, confirm_cycles: int) -> "Dtc":
        """Return the code after its test has failed."""
        status = self.status & ~FRESH | Status.TEST_FAILED | Status.FAILED_THIS_CYCLE
        status |= Status.PENDING | Status.FAILED_SINCE_CLEAR
        if self.failed_cycles + 1 >= confirm_cycles:
            status |= Status.CONFIRMED | Status.WARNING_INDICATOR
        return replace(
            self,
            fault=fault,
            also=also,
            status=status,
            t_ns=self.t_ns if self.has_failed else t_ns,
            passed_cycles=0,
            warm_ups=0,
        )

    def complete(self) -> "Dtc":
        """Return the code after its test has passed."""
        return replace(self, status=self.status & ~FRESH & ~Status.TEST_FAILED)

    def warm_up(self) -> "Dtc":
        """Return the code after a warm-up cycle."""
        counts = self.status & Status.CONFIRMED and not self.status & Status.WARNING_INDICATOR
        return replace(self, warm_ups=self.warm_ups + 1) if counts else self

    def next_cycle(self, profile: ProfileConfig) -> "Dtc":
        """Return the code at the start of the next driving cycle."""
        completed = not self.status & Status.NOT_COMPLETED_THIS_CYCLE
        status = self.status & ~Status.FAILED_THIS_CYCLE & ~Status.TEST_FAILED
        status |= Status.NOT_COMPLETED_THIS_CYCLE
        passed_cycles = self.passed_cycles
        failed_cycles = self.failed_cycles + self.has_failed
        if completed and not self.has_failed:
            passed_cycles += 1
            failed_cycles = 0
            status &= ~Status.PENDING
        if passed_cycles >= profile.lamp_off_cycles:
            status &= ~Status.WARNING_INDICATOR
        if self.warm_ups >= profile.erase_warm_ups:
            status &= ~Status.CONFIRMED
            if not status & Status.PENDING:
                return Dtc(self.code, status=status)
        return replace(
            self, status=status, t_ns=0, failed_cycles=failed_cycles, passed_cycles=passed_cycles
        )

    @property
    def has_failed(self) -> bool:
        """Return whether the test has failed in this driving cycle."""
        return bool(self.status & Status.FAILED_THIS_CYCLE)

    @property
    def state(self) -> Literal["pending", "confirmed"] | None:
        """Return "pending", "confirmed" or None."""
        if self.status & Status.CONFIRMED:
            return "confirmed"
        return "pending" if self.status & Status.PENDING else None
