"""Steps 8 and 9: windows and single results become verdicts, debounce counters and codes.

Results come in the order of time, one after the other.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from operator import attrgetter
from typing import Final

import numpy as np

from monitor.base.config import Config, DebounceConfig
from monitor.base.types import FloatArray
from monitor.judge.bank import Hypothesis
from monitor.judge.bias import Bias, BiasRule, paper_failed
from monitor.judge.catalyst_rule import Claim
from monitor.judge.claims import Noise
from monitor.judge.findings import (
    Change,
    Counted,
    CutJudged,
    DtcChanged,
    Evidence,
    Facts,
    WindowJudged,
)
from monitor.judge.limits import Limits
from monitor.judge.movement import UNKNOWN, Moved, MovementRule
from monitor.judge.plausibility import TickResult
from monitor.judge.rear_circuit import CIRCUIT, HEATER
from monitor.judge.residual import lambda_of, means_and_stds
from monitor.judge.response import EDGES, Response, ResponseRule
from monitor.judge.rules import RuleClass, opinion
from monitor.judge.window import Window
from monitor.memory.codes import CODES, OF_VEHICLE, codes_on
from monitor.memory.debounce import FAILED, PASSED, Debounce
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import TestResult
from monitor.memory.reference import Seen

CIRCUIT_TESTS: Final = (CIRCUIT, HEATER)
LAMBDA_LEAST: Final = 0.1  # what stays of a measurement whose offset is taken off


class Decisions:
    """Everything that is decided about one sensor in one driving cycle.

    transform : of the model, "phi" or "none"
    store : fault memory; a new driving cycle begins in the caller's hands
    rules : of plug-ins, by the name of their test
    """

    def __init__(
        self,
        limits: Limits,
        config: Config,
        hypotheses: tuple[Hypothesis, ...],
        transform: str,
        period_s: float,
        store: DtcStore,
        rules: Mapping[str, RuleClass] | None = None,
    ) -> None:
        self.store, self._limits, self._config = store, limits, config
        self._transform = transform
        self._window_s = config.window.n_samples * period_s
        self._response = ResponseRule(
            config=config.response,
            bank=hypotheses,
            noise=Noise(limits.noise, limits.noise_memory),
            period_s=period_s,
            evidence_weight=limits.evidence,
            gain_reference=limits.gain_expected,
        )
        # edges of fuel cuts are judged by the same claims, and their evidence is the same
        self._cut_response = ResponseRule(
            config=config.response,
            bank=hypotheses,
            noise=Noise(limits.noise, limits.noise_memory),
            period_s=period_s,
            evidence_weight=limits.evidence_cut,
            gain_reference=limits.gain_cut,
            shares=self._response,
        )
        self._movement = MovementRule(
            config.movement,
            limits.noise,
            limits.noise_memory,
            period_s,
            self._response.evidence_fail,
        )
        self._may_be_dead = False
        self._bias = BiasRule(config.bias, limits.offset_low, limits.offset_high, limits.offset_std)
        self._rules = {test: kind() for test, kind in (rules or {}).items()}
        self._debounce = dict.fromkeys((*OF_VEHICLE, *self._rules), Debounce())
        self._failing: dict[str, str] = {}  # the latest fault of each test
        self._named: dict[str, str] = {}  # the fault that each matured test has set
        self.completed = False  # the response test reached a decision
        self._decided: set[str] = set()  # tests that reached one
        self._suspicious = False  # a window failed
        self._windows, self._offset_sum = 0, 0.0

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Return the tests that have reached no decision."""
        return tuple(
            test
            for test in OF_VEHICLE
            if test not in self._decided or (test == "response" and self._may_be_dead)
        )

    def matured(self, result: TickResult, t_ns: int) -> list[Change]:
        """Take the last of so many alike results in a row; those before it are not needed."""
        self._debounce[result.test] = Debounce(FAILED if result.failed else PASSED)
        return self._mature(result.test, result.failed, result.fault, (), t_ns)

    def activity(self, failed: bool, fault: str, t_ns: int) -> Sequence[Change]:
        """Take a judged stretch of the activity test."""
        return self._step("activity", failed, by=self._by(failed), fault=fault, also=(), t_ns=t_ns)

    def behind(self, test: str, claim: Claim, t_ns: int) -> Sequence[Change]:
        """Take how the evidence about catalyst, downstream sensor or oxygen balance stands.

        A failed balance names the upstream sensor, whatever the bias rule says of it: that rule
        knows no absolute reference.
        """
        if claim.outcome == "inconclusive":
            return ()
        failed = claim.outcome == "failed"
        if test in CIRCUIT_TESTS:  # they decide at once
            return self.matured(TickResult(test, failed, claim.fault or ""), t_ns)
        if test == "bias":
            is_new = self._debounce["balance"].failed and self._named.get(test) != claim.fault
            return self._mature(test, failed, claim.fault or "", (), t_ns) if is_new else ()
        return self._step(
            test, failed, by=self._by(failed), fault=claim.fault or "", also=claim.also, t_ns=t_ns
        )

    def facts(self, windows: Sequence[Window]) -> list[Facts]:
        """Return the facts of windows that follow each other.

        Every window goes through here once, before ``window`` or ``cut`` decides.
        """
        found: list[Facts] = []
        for is_cut, group in groupby(windows, attrgetter("is_cut")):
            facts_of = self._cut_facts if is_cut else self._window_facts
            found += facts_of([*group])
        return found

    def _cut_facts(self, windows: Sequence[Window]) -> list[Facts]:
        measured = np.array([window.measured for window in windows])
        mean, std = means_and_stds(np.array([window.residual for window in windows]))
        banks = [window.bank for window in windows]
        ignore = np.zeros(len(windows), dtype=np.bool_)
        responses = self._cut_response.judge(self._orient(measured), banks, ignore)
        own = zip(mean.tolist(), std.tolist(), responses, strict=True)
        return [
            Facts(
                mean=m,
                std=s,
                no_evidence=False,
                beyond=None,
                offset=0.0,
                response=each,
                moved=UNKNOWN,
            )
            for m, s, each in own
        ]

    def _window_facts(self, windows: Sequence[Window]) -> list[Facts]:
        measured = np.array([window.measured for window in windows])
        mean, std = means_and_stds(np.array([window.residual for window in windows]))
        span = np.maximum.reduce(measured, axis=1) - np.minimum.reduce(measured, axis=1)
        ignore = span <= self._config.plausibility.stuck_range
        beyond: list[float] | list[None] = [None] * len(windows)
        if self._limits.region is not None:
            apart = self._limits.region.beyond(np.array([window.inputs for window in windows]))
            ignore |= apart > 1.0
            beyond = apart.tolist()
        # an offset in lambda would change the gain in phi
        phi = self._orient(measured - mean[:, np.newaxis])
        banks = [window.bank for window in windows]
        responses = self._response.judge(phi, banks, ignore)
        # a sensor slow or late on one edge rectifies the modulation, which shifts its mean
        likeliest = [bank[:, each.column] for bank, each in zip(banks, responses, strict=True)]
        beside = measured - lambda_of(np.array(likeliest), self._transform)
        offset = np.add.reduce(beside, axis=1) / beside.shape[1]
        healthy = np.array([bank[:, 0] for bank in banks])
        moved = self._movement.judge(phi, healthy, ignore)
        own = mean.tolist(), std.tolist(), ignore.tolist(), beyond
        return list(map(Facts, *own, offset.tolist(), responses, moved))

    def window(self, window: Window, facts: Facts) -> Iterator[WindowJudged | Change]:
        """Take a full window; yield its verdict, then the codes that it changes."""
        mean, std, no_evidence, beyond, offset, response, moved = facts
        response = self._unless_dead(response, moved)
        bias = self._bias.judge(offset, ignore=no_evidence or self._may_be_dead)
        if response.outcome == "inconclusive" and bias.outcome == "failed":
            bias = replace(bias, outcome="inconclusive", fault=None)
        outcome, fault, also = response.outcome, response.fault, response.also
        if bias.outcome == "failed" and outcome != "failed":
            outcome, fault, also = "failed", bias.fault, ()
        limits = self._limits
        yield WindowJudged(
            window=window,
            mean=mean,
            std=std,
            paper_failed=paper_failed(mean, std, limits.j_mu, limits.j_sigma),
            outcome=outcome,
            fault=fault,
            also=also,
            excited=self._is_excited(response),
            statistics={
                **response.statistics,
                "offset": bias.offset,
                "offset_std": bias.offset_std,
                "offset_beyond": bias.beyond,
                "dead": moved.dead,
                "holds": moved.holds,
                **({} if beyond is None else {"region_beyond": beyond}),
            },
        )
        self.store.report(self._results(response, bias))
        self._suspicious |= outcome == "failed"
        self._windows += 1
        self._offset_sum += offset
        for test, result in (("response", response), ("bias", bias)):
            if result.outcome != "inconclusive":
                failed, name = result.outcome == "failed", result.fault or ""
                yield from self._step(
                    test,
                    failed,
                    by=self._by(failed),
                    fault=name,
                    also=result.also,
                    t_ns=window.t_end_ns,
                )
        yield from self._by_plugins(window)
        self.completed |= self._debounce["response"].failed or self._debounce["response"].passed

    def _by_plugins(self, window: Window) -> Iterator[Change]:
        """Let the rules of plug-ins judge a window."""
        for test, rule in self._rules.items():
            said = opinion(test, rule, window)
            if said.outcome == "inconclusive":
                continue
            failed, fault = said.outcome == "failed", said.fault or ""
            self._suspicious |= failed
            by = self._by(failed)
            yield from self._step(test, failed, by=by, fault=fault, also=(), t_ns=window.t_end_ns)

    def cut(self, window: Window, facts: Facts) -> Iterator[CutJudged | Change]:
        """Take a full window around a fuel cut; yield its verdict, then the codes it changes."""
        response, t_ns = facts.response, window.t_end_ns
        if self._may_be_dead:
            response = replace(response, outcome="inconclusive", fault=None, also=())
        yield CutJudged(t_ns, response.outcome, response.fault, response.statistics)
        failed = response.outcome == "failed"
        self._suspicious |= failed
        if response.outcome != "inconclusive":
            name = response.fault or ""
            yield from self._step(
                "response", failed, by=self._by(failed), fault=name, also=response.also, t_ns=t_ns
            )
        self.completed |= self._debounce["response"].failed or self._debounce["response"].passed

    def _unless_dead(self, response: Response, moved: Moved) -> Response:
        """Return the response rule's finding, unless the reading may not move at all."""
        doubt = max(moved.dead, moved.holds)
        self._may_be_dead = doubt >= self._config.movement.doubt
        if moved.fault is not None:
            return replace(response, outcome="failed", fault=moved.fault, also=())
        if self._may_be_dead:
            return replace(response, outcome="inconclusive", fault=None, also=())
        return response

    def _results(self, response: Response, bias: Bias) -> list[TestResult]:
        """Return the results of service $06: the estimates so far against their limits."""
        config, limits, found = self._config.response, self._limits, response.statistics
        high = {"lag": config.lag_limit_s, "dead_time": config.delay_limit_s}
        results = [
            TestResult("response", f"{what}_{edge}_s", value, 0.0, high[what])
            for what in high
            for edge in EDGES
            if isinstance(value := found[f"{what}_{edge}_s"], float)
        ]
        gain, unit = found["gain"], limits.gain_expected
        if not isinstance(gain, float):
            results = []  # no window was judged yet
        else:
            low = unit * config.gain_sound_min
            results.append(TestResult("response", "gain", gain, low, unit * config.gain_max))
        if bias.beyond is not None:
            results.append(
                TestResult("bias", "offset", bias.offset, limits.offset_low, limits.offset_high)
            )
        return results

    def _is_excited(self, response: Response) -> bool:
        excitation = response.statistics["excitation"]
        return isinstance(excitation, float) and excitation >= self._limits.excitation

    def prefailed(self) -> dict[str, int]:
        """Return the codes whose tests have failed, but not often enough, with their counters."""
        close_coupled = self._config.catalyst.close_coupled
        return {
            code: self._debounce[test].count
            for test, fault in self._failing.items()
            if 0 < self._debounce[test].count < FAILED
            for code in codes_on(fault, close_coupled=close_coupled)
        }

    def probability(self, fault: str) -> float:
        """Return the probability of a fault's name among the names with the same code."""
        odds = self._response.odds
        if fault not in odds:
            return 1.0
        alike = [value for name, value in odds.items() if CODES[name] == CODES[fault]]
        return math.exp(odds[fault] - max(alike)) / sum(math.exp(v - max(alike)) for v in alike)

    def evidence(self) -> dict[str, Evidence]:
        """Return how far the response test is from a decision about each fault.

        The time left supposes that the evidence goes on to grow as it did so far.
        """
        rule, n_cuts = self._response, self._cut_response.windows
        # a window around a fuel cut has half the samples
        seconds = (rule.windows + 0.5 * n_cuts) * self._window_s
        found = {}
        for fault, odds in rule.odds.items():
            needed = rule.evidence_fail if odds > 0.0 else rule.evidence_pass
            missing = max(needed - abs(odds), 0.0)
            left = missing / abs(odds) * seconds if odds else None
            found[fault] = Evidence(odds, needed, left)
        return found

    @property
    def seen(self) -> Seen | None:
        """Return the lesson for the vehicle's reference, None if anything was suspicious."""
        enough = self._windows >= self._config.bias.reference_windows
        sound = self._debounce["response"].passed and not self._suspicious
        if self._transform != "phi" or not (enough and sound) or self.store.fault_flag:
            return None
        gain = self._response.drive_gain / self._limits.gain_model
        return Seen(self._offset_sum / self._windows, gain)

    def _orient(self, measured: FloatArray) -> FloatArray:
        if self._transform == "phi":
            return np.asarray(1.0 / np.maximum(measured, LAMBDA_LEAST))
        return -measured

    def _by(self, failed: bool) -> int:
        debounce = self._config.debounce
        return debounce.response_fail if failed else debounce.response_pass

    def _is_new(self, test: str, failed: bool) -> bool:
        """Return whether a result can still change a test's debounce counter."""
        return self._debounce[test].count != (FAILED if failed else PASSED)

    def _step(
        self, test: str, failed: bool, by: int, fault: str, also: tuple[str, ...], t_ns: int
    ) -> Sequence[Change]:
        """Advance one test's debounce counter; a counter that matures sets or completes codes."""
        if not self._is_new(test, failed):
            return self._renamed(test, fault, also, t_ns) if failed else ()
        if failed:
            self._failing[test] = fault
        before = self._debounce[test]
        after = before.step(failed=failed, by=by)
        self._debounce[test] = after
        if not after.failed and not after.passed:
            return ()
        return self._mature(test, after.failed, fault, also, t_ns)

    def _mature(
        self, test: str, failed: bool, fault: str, also: tuple[str, ...], t_ns: int
    ) -> list[Change]:
        """Set the codes of a fault, or complete those of a test."""
        self._decided.add(test)
        counted = [Counted(t_ns, "numerator")] if self.store.count_judged(test) else []
        if failed:
            self._named[test] = fault
            changed = self._fail(fault, also, t_ns)
        else:
            changed = self.store.complete(test)
        return [*(DtcChanged(t_ns, dtc) for dtc in changed), *counted]

    def _fail(self, fault: str, also: tuple[str, ...], t_ns: int) -> list[Dtc]:
        codes = codes_on(fault, close_coupled=self._config.catalyst.close_coupled)
        return self.store.fail(fault, t_ns, also, codes)

    def _renamed(self, test: str, fault: str, also: tuple[str, ...], t_ns: int) -> Sequence[Change]:
        """Give a code the name that more evidence speaks for, if both names have the same code."""
        before = self._named.get(test, fault)
        if fault == before or CODES[fault] != CODES[before]:
            return ()
        self._named[test] = fault
        return [DtcChanged(t_ns, dtc) for dtc in self._fail(fault, also, t_ns)]


def ticks_to_mature(config: DebounceConfig, period_s: float) -> tuple[int, int]:
    """Return how many failed, and how many passed, results on samples in a row mature.

    A counter begins a row from zero, so nothing before it counts.
    """
    fail_by, pass_by = (
        max(1, math.ceil(-PASSED * period_s / seconds))
        for seconds in (config.tick_fail_s, config.tick_pass_s)
    )
    return math.ceil(FAILED / fail_by), math.ceil(-PASSED / pass_by)
