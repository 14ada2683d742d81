"""Step 9: results of the tests advance debounce counters, and counters that mature change codes."""

import math
from collections.abc import Iterable, Sequence

from monitor.base.config import Config, DebounceConfig
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.findings import Change, Counted, DtcChanged
from monitor.judge.window import Opinion
from monitor.memory.codes import CODES, codes_on
from monitor.memory.debounce import FAILED, PASSED, Debounce
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore


class Counters:
    """One debounce counter for each test, and the fault that it last failed with.

    tests : their names
    """

    def __init__(self, tests: Iterable[str], config: Config, store: DtcStore) -> None:
        self._config, self._store = config, store
        self.debounce = dict.fromkeys(tests, Debounce())
        self.named: dict[str, str] = {}  # the fault that each matured test has set
        self.decided: set[str] = set()  # tests that reached a decision

    def take(self, test: str, found: Opinion, t_ns: int) -> Sequence[Change]:
        """Advance one test's counter by what a rule found; nothing where it is inconclusive."""
        if found.outcome == "inconclusive":
            return ()
        failed, fault = found.outcome == "failed", found.fault or ""
        return self.step(test, failed=failed, fault=fault, also=found.also, t_ns=t_ns)

    def step(
        self, test: str, *, failed: bool, fault: str, t_ns: int, also: tuple[str, ...] = ()
    ) -> Sequence[Change]:
        """Advance one test's counter; a counter that matures sets or completes codes."""
        before = self.debounce[test]
        if before.count == (FAILED if failed else PASSED):  # no result can change it
            return self._renamed(test, fault, also, t_ns) if failed else ()
        debounce = self._config.debounce
        by = debounce.response_fail if failed else debounce.response_pass
        after = self.debounce[test] = before.step(failed=failed, by=by)
        if not after.failed and not after.passed:
            return ()
        return self.set_codes(test, failed=after.failed, fault=fault, also=also, t_ns=t_ns)

    def electrical(self, result: TickResult, t_ns: int) -> Sequence[Change]:
        """Take a result of a test without model; those before it in its row are not needed."""
        test, failed, fault = result
        if test == "activity":
            return self.step(test, failed=failed, fault=fault, t_ns=t_ns)
        return self.mature(test, failed=failed, fault=fault, t_ns=t_ns)

    def mature(self, test: str, *, failed: bool, fault: str, t_ns: int) -> list[Change]:
        """Take the last of so many alike results in a row."""
        self.debounce[test] = Debounce(FAILED if failed else PASSED)
        return self.set_codes(test, failed=failed, fault=fault, t_ns=t_ns)

    def set_codes(
        self, test: str, *, failed: bool, fault: str, t_ns: int, also: tuple[str, ...] = ()
    ) -> list[Change]:
        """Set the codes of a fault, or complete those of a test."""
        self.decided.add(test)
        counted = [Counted(t_ns, "numerator")] if self._store.count_judged(test) else []
        if failed:
            self.named[test] = fault
            changed = self._fail(fault, also, t_ns)
        else:
            changed = self._store.complete(test)
        return [*(DtcChanged(t_ns, dtc) for dtc in changed), *counted]

    def _renamed(self, test: str, fault: str, also: tuple[str, ...], t_ns: int) -> Sequence[Change]:
        """Give a code the name that more evidence speaks for, if both names have the same code."""
        before = self.named.get(test, fault)
        if fault == before or CODES[fault] != CODES[before]:
            return ()
        self.named[test] = fault
        return [DtcChanged(t_ns, dtc) for dtc in self._fail(fault, also, t_ns)]

    def _fail(self, fault: str, also: tuple[str, ...], t_ns: int) -> list[Dtc]:
        codes = codes_on(fault, close_coupled=self._config.catalyst.close_coupled)
        return self._store.fail(fault, t_ns, also, codes)


def ticks_to_mature(config: DebounceConfig, period_s: float) -> tuple[int, int]:
    """Return how many failed, and how many passed, results on samples in a row mature.

    A counter begins a row from zero, so nothing before it counts.
    """
    fail_by, pass_by = (
        max(1, math.ceil(-PASSED * period_s / seconds))
        for seconds in (config.tick_fail_s, config.tick_pass_s)
    )
    return math.ceil(FAILED / fail_by), math.ceil(-PASSED / pass_by)
