"""Steps 8 and 9: windows and single results become verdicts, debounce counters and codes.

What is decided here comes in the order of time, one result after the other, whether samples
stream or a recording is judged as a whole.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from monitor.config import Config
from monitor.debounce import PASSED, Debounce
from monitor.dtc import TESTS, Dtc, DtcStore
from monitor.evaluate import BiasRule, Outcome, Response, ResponseRule, paper_failed
from monitor.hypotheses import Hypothesis
from monitor.limits import Limits
from monitor.plausibility import TickResult
from monitor.residual import mean_and_std
from monitor.types import FloatArray
from monitor.window import Window


@dataclass(frozen=True, slots=True)
class WindowJudged:
    """A window of residuals is full and judged."""

    window: Window
    mean: float  # of the residual, output's unit
    std: float
    paper_failed: bool
    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    excited: bool  # the prediction moves enough for the response rule
    statistics: dict[str, float | str | None]


@dataclass(frozen=True, slots=True)
class DtcChanged:
    """A trouble code has a new status."""

    t_ns: int
    dtc: Dtc


class Decisions:
    """Everything that is decided about one sensor in one driving cycle.

    transform : of the model, "phi" or "none"
    store : fault memory; a new driving cycle begins in the caller's hands
    """

    def __init__(
        self,
        limits: Limits,
        config: Config,
        hypotheses: tuple[Hypothesis, ...],
        transform: str,
        period_s: float,
        store: DtcStore,
    ) -> None:
        self.store, self._limits, self._config = store, limits, config
        self._transform = transform
        self._response = ResponseRule(
            config.response, hypotheses, limits.noise, limits.excitation, period_s
        )
        self._bias = BiasRule(config.bias, limits.offset)
        self._fail_by, self._pass_by = (
            max(1, math.ceil(-PASSED * period_s / seconds))
            for seconds in (config.debounce.tick_fail_s, config.debounce.tick_pass_s)
        )
        self._debounce = dict.fromkeys(TESTS, Debounce())
        self.completed = False  # the response test reached a decision

    @property
    def ticks_that_count(self) -> tuple[int, int]:
        """Return after how many failed, and how many passed, results in a row a counter stands."""
        return math.ceil(-PASSED / self._fail_by), math.ceil(-PASSED / self._pass_by)

    def ticks(self, results: Sequence[TickResult], t_ns: int) -> Iterator[DtcChanged]:
        """Take what one sample says about the signal."""
        for result in results:
            if self._is_new(result.test, result.failed):
                by = self._fail_by if result.failed else self._pass_by
                yield from self._step(result.test, result.failed, by, result.fault, (), t_ns)

    def activity(self, failed: bool, fault: str, t_ns: int) -> Sequence[DtcChanged]:
        """Take a judged stretch of the activity test."""
        return self._step("activity", failed, self._by(failed), fault, (), t_ns)

    def window(self, window: Window) -> Iterator[WindowJudged | DtcChanged]:
        """Take a full window; yield its verdict, then the codes that it changes."""
        mean, std = mean_and_std(window.residual)
        frozen = (
            float(window.measured.max() - window.measured.min())
            <= self._config.plausibility.stuck_range
        )
        bias = self._bias.judge(mean, ignore=frozen)
        response = self._response.judge(self._orient(window.measured), window.bank, ignore=frozen)
        if bias.outcome == "failed" and response.fault == "gain_low":
            # an offset in lambda changes the gain in phi, so the two are not told apart here
            response = replace(response, outcome="inconclusive", fault=None)
        outcome, fault, also = response.outcome, response.fault, response.also
        if bias.outcome == "failed" and outcome != "failed":
            outcome, fault, also = "failed", bias.fault, ()
        limits = self._limits
        yield WindowJudged(
            window,
            mean,
            std,
            paper_failed(mean, std, limits.j_mu, limits.j_sigma),
            outcome,
            fault,
            also,
            self._is_excited(response),
            {**response.statistics, "offset": bias.offset},
        )
        for test, result in (("response", response), ("bias", bias)):
            if result.outcome != "inconclusive":
                failed, name = result.outcome == "failed", result.fault or ""
                yield from self._step(
                    test, failed, self._by(failed), name, result.also, window.t_end_ns
                )
        self.completed |= self._debounce["response"].failed or self._debounce["response"].passed

    def _is_excited(self, response: Response) -> bool:
        excitation = response.statistics["excitation"]
        return isinstance(excitation, float) and excitation >= self._limits.excitation

    def _orient(self, measured: FloatArray) -> FloatArray:
        return 1.0 / measured if self._transform == "phi" else -measured

    def _by(self, failed: bool) -> int:
        debounce = self._config.debounce
        return debounce.response_fail if failed else debounce.response_pass

    def _is_new(self, test: str, failed: bool) -> bool:
        """Return whether a result can still change a test's debounce counter."""
        counter = self._debounce[test]
        return not (counter.failed if failed else counter.passed)

    def _step(
        self, test: str, failed: bool, by: int, fault: str, also: tuple[str, ...], t_ns: int
    ) -> Sequence[DtcChanged]:
        """Advance one test's debounce counter; a counter that matures sets or completes codes."""
        if not self._is_new(test, failed):
            return ()
        before = self._debounce[test]
        after = before.step(failed=failed, by=by)
        self._debounce[test] = after
        changed: list[Dtc] = []
        if after.failed and not before.failed:
            changed = self.store.fail(fault, t_ns, also)
        elif after.passed and not before.passed:
            changed = self.store.complete(test)
        return [DtcChanged(t_ns, dtc) for dtc in changed]
