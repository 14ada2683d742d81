"""Step 9: results of the tests advance debounce counters, and counters that mature change codes."""

import math
from collections.abc import Iterable, Sequence

from monitor.base.config import Config, DebounceConfig
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.findings import Change, Counted, DtcChanged
from monitor.judge.window import Opinion
from monitor.memory.codes import CODES, codes_on
from monitor.memory.debounce import FAILED, PASSED, Debounce
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

    def take(
        self, test: str, found: Opinion, t_ns: int, *, at_once: bool = False
    ) -> Sequence[Change]:
        """Advance one test's counter by a finding; one that matures sets or completes codes.

        at_once : the finding decides alone
        Once a test has failed, more evidence may change the name that stands for a code.
        """
        if found.outcome == "inconclusive":
            return ()
        failed, fault, before = found.outcome == "failed", found.fault or "", self.debounce[test]
        is_new = at_once or before.count != (FAILED if failed else PASSED)
        if not is_new:  # no result can change the counter
            named = self.named.get(test, fault)
            if not failed or fault == named or CODES[fault] != CODES[named]:
                return ()
        debounce = self._config.debounce
        by = debounce.response_fail if failed else debounce.response_pass
        after = self.debounce[test] = before.step(failed=failed, by=-PASSED if at_once else by)
        if not after.failed and not after.passed:
            return ()
        self.decided.add(test)
        counts = is_new and self._store.count_judged(test)
        counted = [Counted(t_ns, "numerator", test)] if counts else []
        if failed:
            self.named[test] = fault
            codes = codes_on(fault, close_coupled=self._config.catalyst.close_coupled)
            changed = self._store.fail(fault, t_ns, found.also, codes)
        else:
            changed = self._store.complete(test)
        return [*(DtcChanged(t_ns, dtc) for dtc in changed), *counted]

    def electrical(self, result: TickResult, t_ns: int) -> Sequence[Change]:
        """Take a result of a test without model; those before it in its row are not needed."""
        found = Opinion("failed" if result.failed else "passed", result.fault)
        return self.take(result.test, found, t_ns, at_once=result.test != "activity")


def ticks_to_mature(config: DebounceConfig, period_s: float) -> tuple[int, int]:
    """Return how many failed, and how many passed, results on samples in a row mature.

    A counter begins a row from zero, so nothing before it counts.
    """
    fail_by, pass_by = (
        max(1, math.ceil(-PASSED * period_s / seconds))
        for seconds in (config.tick_fail_s, config.tick_pass_s)
    )
    return math.ceil(FAILED / fail_by), math.ceil(-PASSED / pass_by)
