"""The fault memory of one monitor in RAM: codes, freeze frames, ratios and counts.

Sources: 13 CCR 1968.2 (d)(2) and (d)(4), 40 CFR 86.1806, UN R83 annex 11. The configuration holds
the numbers of cycles per regulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from monitor.base.config import ProfileConfig, shipped
from monitor.memory.codes import (
    BEHIND,
    CODES,
    CONTINUOUS,
    LOST,
    OF_MONITOR,
    OF_VEHICLE,
    TEST_OF,
    TESTS,
    codes_of,
    every,
    tests_of,
)
from monitor.memory.dtc import FRESH, Dtc, Status
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult

RATIO_MOST = 0xFFFF  # when a counter of a ratio reaches it, numerator and denominator are halved


@dataclass(frozen=True, slots=True)
class Saved:
    """The content of the fault memory that outlives a driving cycle."""

    dtcs: tuple[Dtc, ...] = ()
    freeze_frames: tuple[FreezeFrame, ...] = ()  # in the order in which they were set
    permanent: Mapping[str, str] = field(default_factory=dict)  # code → fault that set it
    results: tuple[TestResult, ...] = ()
    ratios: tuple[Ratio, ...] = ()
    counts: Counts = field(default_factory=Counts)
    completed: frozenset[str] = frozenset()  # tests completed since the codes were cleared


class DtcStore:
    """Fault memory of one monitor, held in RAM.

    saved : content to start from, by default empty
    profile : numbers of cycles until codes change, by default the shipped ones
    """

    def __init__(self, saved: Saved | None = None, profile: ProfileConfig | None = None) -> None:
        saved = saved or Saved()
        self._profile = profile or shipped().profile
        self._hold({c: Dtc(c) for c in every()} | {dtc.code: dtc for dtc in saved.dtcs})
        self._frames = {frame.code: frame for frame in saved.freeze_frames}
        self._permanent = dict(saved.permanent)
        self._results = {(r.test, r.quantity): r for r in saved.results}
        self._ratios = {test: Ratio(test) for test in OF_VEHICLE}
        self._ratios |= {ratio.test: ratio for ratio in saved.ratios}
        self.counts = replace(saved.counts)  # over the life, and since the codes were cleared
        self._completed = set(saved.completed)
        self._passed: set[str] = set()  # tests that have passed in this driving cycle
        self._failed: set[str] = set()  # codes that have failed in it, even if cleared since
        self._judged: set[str] = set()  # tests whose numerator counts this driving cycle
        self._is_general = False  # the general denominator counts this driving cycle
        self.clearings = 0
        self.is_lost: bool | None = None  # whether the memory on disk was lost; None without one

    def admit(self) -> None:
        """Hold the codes of plug-ins, too, that became known since."""
        self._hold({c: Dtc(c) for c in every()} | self._dtcs)

    def judge_memory(self, t_ns: int) -> list[Dtc]:
        """Judge the memory on disk, once in a driving cycle; return the codes that changed."""
        if self.is_lost is None:
            return []
        is_lost, self.is_lost = self.is_lost, False
        return self.fail(LOST, t_ns) if is_lost else self.complete(TEST_OF[LOST])

    def fail(
        self,
        fault: str,
        t_ns: int,
        also: tuple[str, ...] = (),
        codes: tuple[str, ...] | None = None,
    ) -> list[Dtc]:
        """Set the codes of a fault that failed at ``t_ns``; return the codes that changed.

        codes : those that the fault sets on this vehicle, by default the usual ones
        """
        self._completed.add(TEST_OF[fault])
        needed, most = self._profile.confirm_cycles, self._profile.permanent_most
        new = {c: self._dtcs[c].fail(fault, also, t_ns, needed) for c in codes or CODES[fault]}
        self._failed |= new.keys()
        for code, dtc in new.items():
            lit = dtc.status & Status.WARNING_INDICATOR
            if lit and (code in self._permanent or len(self._permanent) < most):
                self._permanent[code] = fault
            if dtc.state == "confirmed" != self._dtcs[code].state:
                self._frames.pop(code, None)  # the frame of the confirmed state replaces it
        was_lit = self.mil
        changed = self._update(new)
        if self.mil and not was_lit:
            self.counts.distance_with_mil_km = self.counts.engine_run_with_mil_s = 0.0
        return changed

    def complete(self, test: str) -> list[Dtc]:
        """Record that a test has passed; return the codes that changed.

        Completed are the codes set by a fault of this test, and never-set codes once every test
        that can set them has passed. A code set by another test keeps its status.
        """
        self._passed.add(test)
        self._completed.add(test)
        if test == "communication":
            self.counts.sensor_heard = 1
        faults = TESTS[test]
        codes = sorted({code for fault in faults for code in codes_of(fault)})
        done = [c for c in codes if self._dtcs[c].fault in faults or self._is_clean(c)]
        return self._update({c: self._dtcs[c].complete() for c in done})

    def _is_clean(self, code: str) -> bool:
        return not self._dtcs[code].fault and self._passed >= tests_of(code)

    def freeze(self, frame: FreezeFrame) -> None:
        """Keep the signals of a failure, unless the code's state has a frame."""
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
        """Return whether the driving cycle that ends erases a permanent code.

        It does if the lamp goes out. It also does if the code was cleared and its test has passed
        since, of an ended process by the status byte; a continuous test then also needs a cycle
        that the general denominator counts.
        """
        if new[code].status & Status.WARNING_INDICATOR:
            return False
        if self._dtcs[code].status & Status.WARNING_INDICATOR:
            return True
        test = TEST_OF.get(self._permanent[code])  # None of a plug-in that is not active
        is_open = self._dtcs[code].status & (FRESH | Status.FAILED_THIS_CYCLE)
        passed = (test in self._passed or not is_open) and code not in self._failed
        return passed and (test not in CONTINUOUS or self._is_general)

    def clear(self) -> list[Dtc]:
        """Erase codes, freeze frames, results and readiness; return the codes that changed.

        Permanent codes, ratios, ignition cycles and the general denominator stay.
        """
        self._frames.clear()
        self._results.clear()
        self._completed.clear()
        self._passed.clear()
        kept = self.counts
        self.counts = Counts(
            kept.ignition_cycles, kept.general_denominator, sensor_heard=kept.sensor_heard
        )
        self.clearings += 1
        return self._update({code: Dtc(code) for code in self._dtcs})

    def _update(self, new: dict[str, Dtc]) -> list[Dtc]:
        changed = [dtc for code, dtc in new.items() if dtc != self._dtcs[code]]
        self._hold(self._dtcs | new)
        return changed

    def _hold(self, dtcs: dict[str, Dtc]) -> None:
        self._dtcs = dtcs
        # whether a code turns the malfunction indicator lamp on
        self.mil = any(dtc.status & Status.WARNING_INDICATOR for dtc in dtcs.values())

    def report(self, results: Sequence[TestResult]) -> None:
        """Keep the latest results of a test with their limits."""
        self._results |= {(r.test, r.quantity): r for r in results}

    def count_judged(self, test: str) -> bool:
        """Count that a test could have found a fault; return whether it is new in this cycle."""
        if test in self._judged or test not in self._ratios or self._is_paused(test):
            return False
        self._judged.add(test)
        before = self._ratios[test]
        self._ratios[test] = _bounded(replace(before, numerator=before.numerator + 1))
        return True

    def decide(self, test: str) -> None:
        """Record that a test without codes of its own has reached a result."""
        self._completed.add(test)

    def count_general_denominator(self) -> None:
        """Count this driving cycle in the general denominator, at most once."""
        if self._is_general:
            return
        self._is_general = True
        self.counts.general_denominator += 1
        for test, ratio in self._ratios.items():
            if not self._is_paused(test):
                self._ratios[test] = _bounded(replace(ratio, denominator=ratio.denominator + 1))

    def _is_paused(self, test: str) -> bool:
        """Return whether a code of a continuous test stops this test from counting, (d)(4)."""
        failing = {TEST_OF.get(d.fault) for d in self._dtcs.values() if d.state}
        return test not in CONTINUOUS and not failing.isdisjoint(CONTINUOUS)

    def count_warm_up(self) -> None:
        """Count a warm-up cycle."""
        self.counts.warm_ups_since_clear += 1
        self._hold({code: dtc.warm_up() for code, dtc in self._dtcs.items()})

    def drive(self, engine_run_s: float, distance_km: float) -> None:
        """Count a stretch of driving."""
        counts = self.counts
        counts.distance_since_clear_km += distance_km
        counts.engine_run_since_clear_s += engine_run_s
        if self.mil:
            counts.distance_with_mil_km += distance_km
            counts.engine_run_with_mil_s += engine_run_s

    @property
    def all(self) -> tuple[Dtc, ...]:
        """Return every code, including those that never failed."""
        return tuple(self._dtcs.values())

    @property
    def active(self) -> list[Dtc]:
        """Return the pending and confirmed codes, in the order of their failures."""
        return sorted((d for d in self.all if d.state), key=lambda d: (d.t_ns, d.code))

    @property
    def fault_flag(self) -> bool:
        """Return True if a code of the vehicle is pending or confirmed."""
        return any(d.state and d.fault not in OF_MONITOR for d in self.all)

    @property
    def freeze_frames(self) -> Mapping[str, FreezeFrame]:
        """Return the freeze frame per code, the most important first.

        Confirmed codes come before pending ones, earlier frames before later ones.
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
        """Return the latest test results with their limits."""
        return tuple(self._results.values())

    @property
    def ratios(self) -> tuple[Ratio, ...]:
        """Return the in-use performance of each test."""
        return tuple(self._ratios.values())

    @property
    def supported_ratios(self) -> tuple[Ratio, ...]:
        """Return the in-use performance of the tests that this vehicle is known to support.

        A test behind the catalyst is one of them once it has decided something.
        """
        known = self._completed | {test for test, ratio in self._ratios.items() if ratio.numerator}
        return tuple(r for r in self.ratios if r.test not in BEHIND or r.test in known)

    def completed_since_clear(self, test: str) -> bool:
        """Return whether a test has passed or failed since the codes were cleared."""
        return test in self._completed

    def completed_this_cycle(self, test: str) -> bool:
        """Return whether a test has passed or failed in this cycle, and since a clearing."""
        failed = {dtc.fault for dtc in self.all if dtc.has_failed}
        return test in self._passed or not failed.isdisjoint(TESTS[test])

    @property
    def saved(self) -> Saved:
        """Return the content that outlives this driving cycle."""
        return Saved(
            dtcs=self.all,
            freeze_frames=tuple(self._frames.values()),
            permanent=dict(self._permanent),
            results=tuple(sorted(self.results, key=lambda r: (r.test, r.quantity))),
            ratios=self.ratios,
            counts=replace(self.counts),
            completed=frozenset(self._completed),
        )


def _bounded(ratio: Ratio) -> Ratio:
    """Halve both numbers when one reaches ``RATIO_MOST``, as 13 CCR 1968.2 (d)(4) asks."""
    if max(ratio.numerator, ratio.denominator) < RATIO_MOST:
        return ratio
    return Ratio(ratio.test, ratio.numerator // 2, ratio.denominator // 2)
