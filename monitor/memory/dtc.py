"""Diagnostic trouble codes: status byte, driving cycles, and what is remembered with them.

A code becomes pending in the driving cycle in which its test fails, and confirmed, with the lamp
on, in a later driving cycle in which the test fails again. Sources: ISO 14229-1 annex D (status
byte), 13 CCR 1968.2 (d)(2) and (d)(4), 40 CFR 86.1806, UN R83 annex 11. The counts stand in the
configuration, as a profile.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntFlag
from types import MappingProxyType
from typing import Literal

from monitor.base.config import ProfileConfig, shipped
from monitor.memory.codes import CODES, CONTINUOUS, TEST_OF, TESTS, tests_of
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult

__all__ = ["CODES", "FRESH", "TESTS", "Dtc", "DtcStore", "Saved", "Status"]

RATIO_MOST = 0xFFFF  # a counter at its end is halved together with its partner


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


_LAMP = int(Status.WARNING_INDICATOR)  # plain integers are looked at ten times as fast
FRESH = Status.NOT_COMPLETED_SINCE_CLEAR | Status.NOT_COMPLETED_THIS_CYCLE


@dataclass(frozen=True, slots=True)
class Dtc:
    """One trouble code and its history; every change gives a new value."""

    code: str
    fault: str = ""  # name of the fault that set it, "" if none did
    also: tuple[str, ...] = ()  # faults that cannot be told from it
    status: Status = FRESH
    t_ns: int = 0  # when it failed first in this driving cycle
    failed_cycles: int = 0  # earlier driving cycles in which it failed, no passed one in between
    passed_cycles: int = 0  # in a row, towards healing
    warm_ups: int = 0  # with the lamp off again, towards erasing

    def fail(self, fault: str, also: tuple[str, ...], t_ns: int, confirm_cycles: int) -> "Dtc":
        """Return the code after its test has matured to failed."""
        first = not self.status & Status.FAILED_THIS_CYCLE
        status = self.status & ~FRESH | Status.TEST_FAILED | Status.FAILED_THIS_CYCLE
        status |= Status.PENDING | Status.FAILED_SINCE_CLEAR
        if self.failed_cycles + 1 >= confirm_cycles:
            status |= Status.CONFIRMED | Status.WARNING_INDICATOR
        return replace(
            self,
            fault=fault,
            also=also,
            status=status,
            t_ns=t_ns if first else self.t_ns,
            passed_cycles=0,
            warm_ups=0,
        )

    def complete(self) -> "Dtc":
        """Return the code after its test has matured to passed."""
        return replace(self, status=self.status & ~FRESH & ~Status.TEST_FAILED)

    def warm_up(self) -> "Dtc":
        """Return the code after a warm-up cycle."""
        counts = self.status & Status.CONFIRMED and not self.status & Status.WARNING_INDICATOR
        return replace(self, warm_ups=self.warm_ups + 1) if counts else self

    def next_cycle(self, profile: ProfileConfig) -> "Dtc":
        """Return the code at the start of the next driving cycle."""
        completed = not self.status & Status.NOT_COMPLETED_THIS_CYCLE
        failed = bool(self.status & Status.FAILED_THIS_CYCLE)
        status = self.status & ~Status.FAILED_THIS_CYCLE & ~Status.TEST_FAILED
        status |= Status.NOT_COMPLETED_THIS_CYCLE
        passed_cycles = self.passed_cycles
        failed_cycles = self.failed_cycles + failed
        if completed and not failed:
            passed_cycles += 1
            failed_cycles = 0
            status &= ~Status.PENDING
        if passed_cycles >= profile.lamp_off_cycles:
            status &= ~Status.WARNING_INDICATOR
        if self.warm_ups >= profile.erase_warm_ups:
            return Dtc(self.code, status=status & ~Status.CONFIRMED)
        return replace(
            self,
            status=status,
            t_ns=0,
            failed_cycles=failed_cycles,
            passed_cycles=passed_cycles,
        )

    @property
    def state(self) -> Literal["pending", "confirmed"] | None:
        """Return how far the code has matured."""
        if self.status & Status.CONFIRMED:
            return "confirmed"
        return "pending" if self.status & Status.PENDING else None


@dataclass(frozen=True, slots=True)
class Saved:
    """All that outlives a driving cycle."""

    dtcs: tuple[Dtc, ...] = ()
    freeze_frames: tuple[FreezeFrame, ...] = ()  # in the order of their setting
    permanent: Mapping[str, str] = field(default_factory=dict)  # code → the fault that set it
    results: tuple[TestResult, ...] = ()
    ratios: tuple[Ratio, ...] = ()
    counts: Counts = field(default_factory=Counts)
    completed: frozenset[str] = frozenset()  # tests since the last clearing


class DtcStore:
    """Fault memory of one monitor, the side that is in memory.

    saved : what to go on from; by default nothing
    profile : counts until codes change; by default as shipped
    """

    def __init__(self, saved: Saved | None = None, profile: ProfileConfig | None = None) -> None:
        saved = saved or Saved()
        self._profile = profile or shipped().profile
        self._dtcs = {c: Dtc(c) for c in sorted({c for group in CODES.values() for c in group})}
        self._dtcs |= {dtc.code: dtc for dtc in saved.dtcs}
        self._frames = {frame.code: frame for frame in saved.freeze_frames}
        self._permanent = dict(saved.permanent)
        self._results = {(r.test, r.quantity): r for r in saved.results}
        self._ratios = {test: Ratio(test) for test in TESTS}
        self._ratios |= {ratio.test: ratio for ratio in saved.ratios}
        self._counts = saved.counts
        self._completed = set(saved.completed)
        self._passed: set[str] = set()  # tests that have passed in this driving cycle
        self._failed: set[str] = set()  # codes that have failed in it, also if cleared since
        self._judged: set[str] = set()  # tests whose numerator has counted it
        self._is_general = False  # the general denominator has counted it
        self.clearings = 0

    def fail(self, fault: str, t_ns: int, also: tuple[str, ...] = ()) -> list[Dtc]:
        """Set the codes of a fault; return those that changed."""
        self._completed.add(TEST_OF[fault])
        needed = self._profile.confirm_cycles
        new = {c: self._dtcs[c].fail(fault, also, t_ns, needed) for c in CODES[fault]}
        self._failed |= new.keys()
        for code, dtc in new.items():
            lit = dtc.status & Status.WARNING_INDICATOR
            if lit and (code in self._permanent or self._has_room):
                self._permanent[code] = fault
            if dtc.state == "confirmed" != self._dtcs[code].state:
                self._frames.pop(code, None)  # those of its confirming replace the pending ones
        was_lit = self.mil
        changed = self._update(new)
        if self.mil and not was_lit:
            self._counts = replace(
                self._counts, distance_with_mil_km=0.0, engine_run_with_mil_s=0.0
            )
        return changed

    @property
    def _has_room(self) -> bool:
        return len(self._permanent) < self._profile.permanent_most

    def complete(self, test: str) -> list[Dtc]:
        """Note that a test has completed and passed; return what changed.

        A code that a fault of this test has set is complete; one that another test's fault has set
        keeps its status; one that was never set needs every test that can set it.
        """
        self._passed.add(test)
        self._completed.add(test)
        faults = TESTS[test]
        codes = sorted({code for fault in faults for code in CODES[fault]})
        done = [c for c in codes if self._dtcs[c].fault in faults or self._is_clean(c)]
        return self._update({c: self._dtcs[c].complete() for c in done})

    def _is_clean(self, code: str) -> bool:
        return not self._dtcs[code].fault and self._passed >= tests_of(code)

    def freeze(self, frame: FreezeFrame) -> None:
        """Keep the signals at the moment of a code's setting; the first of a state are kept."""
        self._frames.setdefault(frame.code, frame)

    def start_driving_cycle(self) -> list[Dtc]:
        """Begin the next driving cycle; return the codes that changed."""
        new = {code: dtc.next_cycle(self._profile) for code, dtc in self._dtcs.items()}
        self._permanent = {
            code: fault for code, fault in self._permanent.items() if not self._heals(code, new)
        }
        self._passed.clear()
        self._failed.clear()
        self._judged.clear()
        self._is_general = False
        changed = self._update(new)
        self._frames = {c: f for c, f in self._frames.items() if self._dtcs[c].state}
        return changed

    def _heals(self, code: str, new: Mapping[str, Dtc]) -> bool:
        """Return whether the driving cycle that ends takes a permanent code away.

        Either its lamp goes out; or the code was cleared, and its test has passed since, for a
        test that judges every sample in a driving cycle of the general denominator.
        """
        if new[code].status & Status.WARNING_INDICATOR:
            return False
        if self._dtcs[code].status & Status.WARNING_INDICATOR:
            return True
        test = TEST_OF[self._permanent[code]]
        passed = test in self._passed and code not in self._failed
        return passed and (test not in CONTINUOUS or self._is_general)

    def clear(self) -> list[Dtc]:
        """Erase codes, freeze frames, results and readiness; return the codes that changed.

        Permanent codes, ratios, ignition cycles and the general denominator stay.
        """
        self._frames.clear()
        self._results.clear()
        self._completed.clear()
        self._passed.clear()
        kept = self._counts
        self._counts = Counts(kept.ignition_cycles, kept.general_denominator)
        self.clearings += 1
        return self._update({code: Dtc(code) for code in self._dtcs})

    def _update(self, new: dict[str, Dtc]) -> list[Dtc]:
        changed = [dtc for code, dtc in new.items() if dtc != self._dtcs[code]]
        self._dtcs |= new
        return changed

    def report(self, results: Sequence[TestResult]) -> None:
        """Keep the latest results of a test against their limits."""
        self._results |= {(r.test, r.quantity): r for r in results}

    def count_judged(self, test: str) -> bool:
        """Count that a fault of a test would have been found; return whether it is new."""
        if test in self._judged or self._is_paused(test):
            return False
        self._judged.add(test)
        before = self._ratios[test]
        self._ratios[test] = _bounded(replace(before, numerator=before.numerator + 1))
        return True

    def count_general_denominator(self) -> None:
        """Count a driving cycle that was driven as the standard asks, once."""
        if self._is_general:
            return
        self._is_general = True
        general = self._counts.general_denominator + 1
        self._counts = replace(self._counts, general_denominator=general)
        for test, ratio in self._ratios.items():
            if self._is_paused(test):
                continue
            self._ratios[test] = _bounded(replace(ratio, denominator=ratio.denominator + 1))

    def _is_paused(self, test: str) -> bool:
        """Return whether a code of another test keeps this one from judging, (d)(4)."""
        if test in CONTINUOUS:
            return False
        return any(d.state and TEST_OF.get(d.fault) in CONTINUOUS for d in self._dtcs.values())

    def count_ignition_cycle(self) -> None:
        """Count an engine start."""
        self._counts = replace(self._counts, ignition_cycles=self._counts.ignition_cycles + 1)

    def count_warm_up(self) -> None:
        """Count a warm-up cycle."""
        warm_ups = self._counts.warm_ups_since_clear + 1
        self._counts = replace(self._counts, warm_ups_since_clear=warm_ups)
        self._dtcs = {code: dtc.warm_up() for code, dtc in self._dtcs.items()}

    def drive(self, driven: Iterable[tuple[float, float]]) -> None:
        """Count stretches of driving: engine running time in s and distance in km of each."""
        counts, lit = self._counts, float(self.mil)
        run_s, km = counts.engine_run_since_clear_s, counts.distance_since_clear_km
        lit_s, lit_km = counts.engine_run_with_mil_s, counts.distance_with_mil_km
        for engine_run_s, distance_km in driven:
            run_s, km = run_s + engine_run_s, km + distance_km
            lit_s, lit_km = lit_s + lit * engine_run_s, lit_km + lit * distance_km
        self._counts = replace(
            counts,
            distance_since_clear_km=km,
            engine_run_since_clear_s=run_s,
            distance_with_mil_km=lit_km,
            engine_run_with_mil_s=lit_s,
        )

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

    @property
    def mil(self) -> bool:
        """True when a code asks for the malfunction indicator lamp."""
        return any(int(dtc.status) & _LAMP for dtc in self._dtcs.values())

    @property
    def freeze_frames(self) -> Mapping[str, FreezeFrame]:
        """Return the freeze frame of each code, the most important first.

        Confirmed codes go before pending ones, earlier ones before later ones.
        """
        frames = sorted(
            self._frames.values(), key=lambda frame: self._dtcs[frame.code].state != "confirmed"
        )
        return MappingProxyType({frame.code: frame for frame in frames})

    @property
    def permanent(self) -> tuple[str, ...]:
        """Return the permanent codes, the oldest first."""
        return tuple(self._permanent)

    @property
    def results(self) -> tuple[TestResult, ...]:
        """Return the latest results against their limits."""
        return tuple(self._results.values())

    @property
    def ratios(self) -> tuple[Ratio, ...]:
        """Return the in-use performance of each test."""
        return tuple(self._ratios.values())

    @property
    def counts(self) -> Counts:
        """Return what is counted."""
        return self._counts

    def completed_since_clear(self, test: str) -> bool:
        """Return whether a test has passed or failed since the last clearing."""
        return test in self._completed

    @property
    def saved(self) -> Saved:
        """Return all that outlives this driving cycle."""
        return Saved(
            self.all,
            tuple(self._frames.values()),
            dict(self._permanent),
            self.results,
            self.ratios,
            self._counts,
            frozenset(self._completed),
        )


def _bounded(ratio: Ratio) -> Ratio:
    """Halve both numbers when one is at its end, as 13 CCR 1968.2 (d)(4) asks."""
    if max(ratio.numerator, ratio.denominator) < RATIO_MOST:
        return ratio
    return Ratio(ratio.test, ratio.numerator // 2, ratio.denominator // 2)
