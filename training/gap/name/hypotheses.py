"""Every hypothesis about the gap, each with one number: its log evidence above that of no gap.

The hypotheses are each effect of the library, each gradual sensor fault, something that begins
within the recordings (``onset``), another base (``base_moved``), and a cause that none of them is
(``unknown``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.gap.name.evidence import Directions, SeenErrors, freedom
from training.gap.name.onset import Beginning, beginnings
from training.gap.name.verdict import Candidate
from training.greybox.chain import Constants
from training.greybox.effects import Effect
from training.greybox.fit.case import errors, predict
from training.healthy import scoring
from training.healthy.base_state import BaseState

LIMITS: Final = CONFIG.name
NONE, UNKNOWN, ONSET, MOVED = "none", "unknown", "onset", "base_moved"
EVEN_LEAST: Final = 0.01
LOOKED_AT: Final = 5  # candidates that may begin within the recordings
# A base that left its healthy reference: standard deviation, and the step of its derivatives.
FAR: Final = Constants(0.05, 0.2, 2.0, 0.2, 0.2, 0.2)
STEP: Final = Constants(0.01, 0.05, 0.5, 0.05, 0.05, 0.05)
Kind = Literal["effect", "sensor", "unknown"]


@dataclass(frozen=True, slots=True)
class GapHypothesis:
    """One hypothesis and what the recordings say for it."""

    name: str
    kind: Kind
    is_fault: bool  # of the gradual sensor faults
    nats: float  # log evidence above that of no gap
    scale: float  # times the gain of noise, that healthy drives give it; more if it is uneven
    deviance: FloatArray | None = None  # (n_blocks,) held out; of a candidate or a formula
    began: Beginning | None = None  # of an onset


def hypotheses(
    state: BaseState,
    ranking: Sequence[Candidate],
    formula: Candidate | None = None,
    *,
    sensor_known_good: bool,
) -> tuple[GapHypothesis, ...]:
    """Return every hypothesis for the errors of one step.

    ranking : all candidates, fitted, the best first
    formula : the first term of a formula of signals, the form of an unknown effect
    """
    judge = _Judge.of(state)
    found, impossible, onsets = list[GapHypothesis](), [-np.inf], list[GapHypothesis]()
    for place, candidate in enumerate(ranking):
        nats = judge.of_candidate(candidate)
        if not candidate.merit.physical:
            impossible.append(nats)
            continue
        found.append(judge.hypothesis(candidate, nats, sensor_known_good))
        if place < LOOKED_AT and not getattr(candidate.term, "varies", False):
            onsets += judge.onsets(candidate)
    if not sensor_known_good:
        found += [max(onsets, key=lambda each: each.nats / each.scale)] if onsets else []
        found += judge.moved()
    return (*found, judge.unknown(max(impossible), formula))


@dataclass(frozen=True, slots=True)
class _Judge:
    """The errors of a step, their directions, and what they are without any gap."""

    state: BaseState
    directions: Directions
    before: SeenErrors
    none: float  # log evidence

    @classmethod
    def of(cls, state: BaseState) -> "_Judge":
        directions = Directions.of(state.roof)
        before = directions.seen(state.current.residual)
        none = directions.log_evidence(before, np.array([LIMITS.healthy_energy]))
        return cls(state, directions, before, float(none[0]))

    def nats(self, seen: SeenErrors, form: float, gained: float) -> float:
        """Return the evidence of what a hypothesis leaves, above no gap.

        form : share of the hypothesis by which the vehicle's own may have another form
        gained : its sum of squares
        """
        energy = LIMITS.healthy_energy + form**2 * max(gained, 0.0)
        return float(self.directions.log_evidence(seen, np.array([energy]))[0]) - self.none

    def of_candidate(self, candidate: Candidate) -> float:
        after = self.directions.seen(candidate.fit.residual)
        gained = float(self.before.squares) - float(after.squares)
        return self.nats(after, _form(candidate), gained) - _cost(candidate)

    def hypothesis(
        self, candidate: Candidate, nats: float, sensor_known_good: bool
    ) -> GapHypothesis:
        of_sensor = candidate.kind == "sensor fault"
        if isinstance(candidate.term, Effect) and candidate.term.gain_class:
            # A biased sensor in the control loop looks like another fuel: the controller makes the
            # reading right.
            of_sensor = not sensor_known_good
        return GapHypothesis(
            name=candidate.name,
            kind="sensor" if of_sensor else "effect",
            is_fault=candidate.kind == "sensor fault",
            nats=nats,
            scale=self._scale(candidate.name) / _evenness(candidate),
            deviance=scoring.deviance(candidate.fit, self.state.case.blocks),
        )

    def onsets(self, candidate: Candidate) -> list[GapHypothesis]:
        case, current = self.state.case, self.state.current
        scale, form = self._scale(candidate.name), _form(candidate)
        found = []
        for each in beginnings(case, current, candidate.fit, self.directions, self.before):
            nats = self.nats(each.seen, form, each.gained) - _cost(candidate)
            found.append(GapHypothesis(ONSET, "sensor", False, nats, scale, began=each))
        return found

    def moved(self) -> list[GapHypothesis]:
        """Return the hypothesis of another base, straight about the healthy one; none without."""
        case, current = self.state.case, self.state.current
        if case.fixed is None:
            return []
        free, rest = replace(case, fixed=None), current.residual
        columns = []
        for name, step in zip(Constants._fields, STEP, strict=True):
            base = current.base._replace(**{name: getattr(current.base, name) + step})
            read = predict(free, base, current.terms, current.parameters)
            columns.append(errors(free, read) - rest)
        table = np.column_stack(columns)
        weights = np.linalg.lstsq(table, rest)[0]
        after = self.directions.seen(rest - table @ weights)
        ratio = np.array(FAR) / np.array(STEP)
        gram = np.eye(len(ratio)) + ratio[:, np.newaxis] * (table.T @ table) * ratio
        cost = float(np.linalg.slogdet(gram)[1] + np.sum((weights / ratio) ** 2)) / 2.0
        gained = float(self.before.squares) - float(after.squares)
        nats = self.nats(after, LIMITS.fault_form, gained) - cost
        scale = max(self._scale(name) for name in ("slow_symmetric", "delay_symmetric", "biased"))
        return [GapHypothesis(MOVED, "sensor", False, nats, scale)]

    def unknown(self, impossible: float, formula: Candidate | None) -> GapHypothesis:
        """Return the hypothesis of another cause.

        impossible : evidence of the best candidate with constants that it cannot have
        """
        some = self.directions.of_any(self.before, LIMITS.healthy_energy) - self.none
        some -= LIMITS.unknown_nats * len(self.state.current.residual)
        nats, deviance = max(some, impossible - LIMITS.impossible_nats), None
        if formula is not None:
            nats = max(nats, self.of_candidate(formula))
            deviance = scoring.deviance(formula.fit, self.state.case.blocks)
        return GapHypothesis(UNKNOWN, "unknown", False, nats, LIMITS.unknown_scale, deviance)

    def _scale(self, name: str) -> float:
        return max(self.state.surplus.get(name, 1.0), 1.0)


def _form(candidate: Candidate) -> float:
    return LIMITS.fault_form if candidate.kind == "sensor fault" else LIMITS.effect_form


def _evenness(candidate: Candidate) -> float:
    """Return how evenly a candidate gains over the blocks, 1 at most."""
    return float(np.clip(candidate.merit.t / LIMITS.even_t, EVEN_LEAST, 1.0))


def _cost(candidate: Candidate) -> float:
    return freedom(candidate.term.parameters, candidate.fit.standard_errors[-1])
