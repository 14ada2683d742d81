"""Steps 8 and 9: windows and single results become verdicts, and their tests' results.

Results come in the order of time, one after the other.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, TypeVar

from monitor.base.config import Config
from monitor.base.foreign import ForeignError, returned
from monitor.judge.bias import Bias, BiasRule, paper_failed
from monitor.judge.catalyst.rear_circuit import CIRCUIT, HEATER
from monitor.judge.counters import Counters
from monitor.judge.decision.plugins import Rule, RuleClass, opinion
from monitor.judge.decision.window_facts import Facts, WindowFacts
from monitor.judge.electrical.plausibility import TickResult
from monitor.judge.findings import Change, CutJudged, RuleOff, WindowJudged
from monitor.judge.limits import Limits
from monitor.judge.response.bank import EDGES
from monitor.judge.response.movement import DEAD, Moved
from monitor.judge.response.rule import Response
from monitor.judge.trust import OF_MODEL
from monitor.judge.window import Opinion, Window
from monitor.memory.codes import OF_VEHICLE
from monitor.memory.dtc_store import DtcStore
from monitor.memory.obd_records import TestResult
from monitor.memory.reference import Seen
from monitor.model.card import ModelCard

Finding = TypeVar("Finding", Response, Bias)
CIRCUIT_TESTS: Final = (CIRCUIT, HEATER)
CLEARLY: Final = 2.0  # healthy residuals by which a prediction moves; it decides nothing


class Decisions:
    """Everything that is decided about one sensor in one driving cycle.

    card : of the model
    store : fault memory; a new driving cycle begins in the caller's hands
    rules : of plug-ins, by the name of their test
    """

    def __init__(
        self,
        limits: Limits,
        config: Config,
        card: ModelCard,
        store: DtcStore,
        rules: Mapping[str, RuleClass],
    ) -> None:
        self.store, self._limits, self._config = store, limits, config
        self._transform = card.transform
        self.facts = WindowFacts(limits, config, card)
        self._may_be_dead = False
        self.is_foreign = False  # the model does not describe the reading
        # a drive has one fuel; the offsets of other outputs have no known bound
        step_most = config.bias.fuel_span_lambda if card.transform == "phi" else math.inf
        self._bias = BiasRule(config.bias, limits, step_most)
        self._rules: dict[str, Rule | RuleClass] = dict(rules)  # a class until its first window
        self._counters = Counters((*OF_VEHICLE, *rules), config, store)
        self._blind = {test for test in OF_MODEL if limits.trust.is_blind(test)}
        self._by_balance = False  # the balance has named the upstream sensor
        self._suspicious = False  # a window failed

    @property
    def completed(self) -> bool:
        """Return whether the response test reached a decision."""
        return "response" in self._counters.decided

    @property
    def outcomes(self) -> dict[str, str]:
        """Return of each test that sets codes whether it failed, passed or is undecided."""
        decided, found = self._counters.decided, {}
        for test in (*OF_VEHICLE, *(test for test in self._rules if test in decided)):
            passed = "passed" if test in decided else "undecided"
            found[test] = "failed" if self._counters.debounce[test].failed else passed
        if found["response"] == "passed" and self._may_be_dead:
            found["response"] = "undecided"
        return found

    def electrical(self, result: TickResult, t_ns: int) -> Iterator[Change]:
        """Take a result of a test without model; yield the codes that it changes."""
        if not (result.failed and result.fault in self._limits.trust.untold):
            yield from self._counters.electrical(result, t_ns)

    def behind(self, test: str, claim: Opinion, t_ns: int) -> Sequence[Change]:
        """Take how the evidence about catalyst, downstream sensor or oxygen balance stands.

        A failed balance names the upstream sensor, whatever the bias rule says of it: that rule
        knows no absolute reference.
        """
        counters, before = self._counters, self._by_balance
        if test != "bias":
            changed = counters.take(test, claim, t_ns, at_once=test in CIRCUIT_TESTS)
            self._by_balance &= counters.debounce["balance"].failed
            return changed
        self._by_balance = counters.debounce["balance"].failed
        if not self._by_balance or (before and counters.named[test] == claim.fault):
            return ()
        return counters.take(test, claim, t_ns, at_once=True)

    def window(self, window: Window, facts: Facts) -> Iterator[WindowJudged | CutJudged | Change]:
        """Take a full window; yield its verdict, then the codes that it changes.

        A window around a fuel cut tells of the response alone.
        """
        explained = facts.response.explained
        least = self._limits.trust.least_explained
        self.is_foreign = explained is not None and explained < least
        response = self._told("response", self._unless_dead(facts.response, facts.moved))
        if window.is_cut:
            found = response.outcome, response.fault, response.statistics
            yield CutJudged(window, facts.std, *found)
            yield from self._counted("response", response, window)
            return
        ignore = facts.no_evidence or self._may_be_dead
        bias = self._told("bias", self._bias.judge(facts.offset, ignore=ignore))
        yield self._judged(window, facts, response, bias)
        self.store.report(self._results(response, bias))
        yield from self._counted("response", response, window)
        if not self._by_balance:
            yield from self._counted("bias", bias, window)
        yield from self._by_plugins(window)

    def _counted(self, test: str, found: Opinion, window: Window) -> Sequence[Change]:
        """Count a test's finding on a window; return the codes that it changes."""
        self._suspicious |= found.outcome == "failed"
        return self._counters.take(test, found, window.t_end_ns)

    @property
    def seen(self) -> Seen | None:
        """Return the lesson for the vehicle's reference, None if anything was suspicious."""
        enough = self._bias.windows >= self._config.bias.reference_windows
        sound = self._counters.debounce["response"].passed and not self._suspicious
        if self._transform != "phi" or not (enough and sound) or self.store.fault_flag:
            return None
        gain = self.facts.response.drive_gain / self._limits.gain_model
        return Seen(self._bias.total / self._bias.windows, gain)

    def _by_plugins(self, window: Window) -> Iterator[Change]:
        for test in list(self._rules):
            try:
                if isinstance(rule := self._rules[test], type):
                    self._rules[test] = rule = returned(test, rule, rule)
                said = opinion(test, rule, window)
            except ForeignError as error:
                del self._rules[test]
                yield RuleOff(window.t_end_ns, f"the rule {error}; it is switched off")
                continue
            yield from self._counted(test, said, window)

    def _unless_dead(self, response: Response, moved: Moved) -> Response:
        """Return the response rule's finding, unless the reading may not move at all."""
        doubt = max(moved.dead, moved.holds)
        self._may_be_dead = doubt >= self._config.movement.doubt
        if moved.fault is not None:
            return replace(response, outcome="failed", fault=moved.fault, also=())
        if self._may_be_dead:
            return replace(response, outcome="inconclusive", fault=None, also=())
        return response

    def _told(self, test: str, found: Finding) -> Finding:
        """Return a finding, unless the model mistakes its errors for it or excludes no fault.

        Nor does a model find anything in a reading that it does not describe, but that it is dead.
        """
        is_own = found.outcome == "failed" and found.fault in self._limits.trust.untold
        is_foreign = self.is_foreign and found.fault != DEAD
        if is_own or is_foreign or (found.outcome == "passed" and test in self._blind):
            return replace(found, outcome="inconclusive", fault=None, also=())
        return found

    def _judged(self, window: Window, facts: Facts, response: Response, bias: Bias) -> WindowJudged:
        """Return the window's verdict: the response rule's, or the bias rule's if only it fails."""
        verdict = bias if bias.outcome == "failed" != response.outcome else response
        limits, found = self._limits, response.statistics
        return WindowJudged(
            window=window,
            mean=facts.mean,
            std=facts.std,
            paper_failed=paper_failed(facts.mean, facts.std, limits.j_mu, limits.j_sigma),
            outcome=verdict.outcome,
            fault=verdict.fault,
            also=verdict.also,
            excited=found.excitation >= CLEARLY * limits.noise,
            response=found,
            bias=bias,
            moved=facts.moved,
        )

    def _results(self, response: Response, bias: Bias) -> list[TestResult]:
        """Return the results of service $06: the estimates so far against their limits."""
        config, limits, found = self._config.response, self._limits, response.statistics
        results = list[TestResult]()
        if found.gain is not None:  # else no window was judged yet
            high = {"lag": config.lag_limit_s, "dead_time": config.delay_limit_s}
            names = ((what, f"{what}_{edge}_s") for what in high for edge in EDGES)
            results = [TestResult("response", n, getattr(found, n), 0.0, high[w]) for w, n in names]
            within = [limits.gain_expected * x for x in (config.gain_sound_min, config.gain_max)]
            results.append(TestResult("response", "gain", found.gain, *within))
        if bias.beyond is not None:
            within = [limits.offset_low, limits.offset_high]
            results.append(TestResult("bias", "offset", bias.offset, *within))
        return results
