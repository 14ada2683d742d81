"""Whether new runs of any output differ from healthy ones, in what, and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.counts import plain
from training.gap.config import CONFIG
from training.gap.response.account import ResponseAccount, ResponseCurve, past_s, response_of
from training.gap.response.drivers import UNITS, find_drivers, name_of
from training.gap.response.families import Family, families_of
from training.gap.response.reference import ResponseReference
from training.gap.response.trial import Questions, Trial, p_value
from training.greybox.fit.drive import Comparison
from training.pages.numbers import percent

LIMITS: Final = CONFIG.response
SWING: Final = "swing"  # the reading moves more or less; a description if there is no other
SENSOR: Final = (SWING, "offset", "begins", "gain", "timing", "lag", "response")  # a faulty one's
SIMPLE: Final = (
    *("offset", "gain", "timing", "lag", "response"),
    *("level", "dynamic", "timing with", "gain with"),
)
COMMAND: Final = "command"  # the ECU asks for another mixture than on healthy runs
TARGET: Final = "lambda_target"
RICHEST: Final = 0.5  # lambda, the least that is plausible
HALF: Final = 0.5  # of the error beyond healthy runs, that goes with a command
SEED: Final = 0  # of the sets of healthy runs
SHIFTS: Final = (SWING, "timing", "lag", "response", "timing with", "gain", "gain with")


@dataclass(frozen=True, slots=True)
class Finding:
    """One question with its answer."""

    kind: str  # of the family, SWING or "begins"
    driver: str  # "" for the reading as a whole
    z: float
    p_value: float  # of all questions together
    gain: float  # fall of the whitened deviance of the new runs by fits that did not see them
    sentence: str

    @property
    def significant(self) -> bool:
        """Return whether it is beyond chance."""
        return self.p_value < LIMITS.false_share


@dataclass(frozen=True, slots=True)
class Difference:
    """The answers to all questions: the one that describes the difference, then the surest."""

    findings: tuple[Finding, ...]
    best: Finding | None  # None if nothing is beyond chance
    response: ResponseAccount | None  # where the best is a shift, a gain or a swing
    curve: ResponseCurve | None  # where the best is a level

    @property
    def like_sensor(self) -> bool:
        """Return whether the best finding is what a faulty sensor does."""
        return self.best is not None and self.best.kind in SENSOR


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a finding comes from."""

    finding: Finding
    runs: tuple[Comparison, ...]  # the new ones as measured, beside the reference
    family: Family | None
    trial: Trial
    number: int  # of the family


def difference_of(
    new: Sequence[Comparison], reference: ResponseReference, unit: str = ""
) -> Difference:
    """Return in what new runs differ from the healthy ones.

    unit : of the output, for the sentences; empty for phi
    """
    ranked = sorted(_asked(new, reference, unit), key=lambda p: -p.finding.z)
    first = _described_by(ranked)
    if first is None:
        return Difference(tuple(p.finding for p in ranked), None, None, None)
    others = [p.finding for p in ranked if p is not first]
    found, response, curve = first.finding, None, None
    if found.kind in SHIFTS:
        response = response_of(first.runs, reference.healthy)
    if first.family is not None and first.family.knots is not None:
        y = first.trial.held[first.number].coefficients
        curve = ResponseCurve(first.family.knots, y - y.mean())
    best = replace(found, sentence=_sentence(first, response, curve, unit))
    if unit in ("", "phi") and (share := _commanded(new, reference)) >= HALF:
        words = f"{percent(share)} of what exceeds the error of healthy runs goes with its lambda"
        sentence = f"The ECU asks for it: {words} target. {best.sentence}"
        best = replace(best, kind=COMMAND, driver=TARGET, sentence=sentence)
    return Difference((best, *others), best, response, curve)


def _commanded(new: Sequence[Comparison], reference: ResponseReference) -> float:
    """Return the share of the excess error that is gone if the target is taken off the reading."""
    if not all(TARGET in r.signals for r in (*new, *reference.healthy)):
        return 0.0
    asked = [_less_target(r) for r in reference.healthy]
    beyond = ResponseReference.learn(asked, reference.regressors.inputs)
    left = max(beyond.excess([_less_target(r) for r in new]), 0.0)
    return 1.0 - left / max(reference.excess(new), 1e-300)


def _less_target(run: Comparison) -> Comparison:
    target = 1.0 / np.maximum(run.signals[TARGET], RICHEST)
    return replace(run, phi_measured=run.phi_measured - target)


def _described_by(ranked: Sequence[_Place]) -> _Place | None:
    """Return the finding that describes the difference; None if nothing is beyond chance.

    Of the findings that are about as sure as the surest, the one that explains most of runs that it
    did not see; a simpler one that explains nearly as much goes first. How much the reading moves
    is no description as long as there is another.
    """
    significant = [p for p in ranked if p.finding.significant]
    if not significant:
        return None
    surest = min(significant, key=lambda p: (p.finding.kind == SWING, -p.finding.z))
    near = [
        p
        for p in ranked
        if p.family is not None
        and p.finding.p_value < LIMITS.likely
        and p.finding.z >= LIMITS.sure * surest.finding.z
    ]
    if surest.family is None or not near:
        return surest
    most = max(p.finding.gain for p in near)
    good = [p for p in near if p.finding.gain >= LIMITS.near * most]
    return min(good, key=lambda p: (SIMPLE.index(p.finding.kind), -p.finding.gain))


def _asked(new: Sequence[Comparison], reference: ResponseReference, unit: str) -> list[_Place]:
    fresh = reference.beside(new)
    runs = [*fresh, *reference.healthy]
    families = families_of(runs, find_drivers(runs), reference.regressors.inputs)
    questions = Questions.of(fresh, reference.healthy, families, reference.spread)
    plain = tuple(
        replace(r, phi_predicted=f.phi_predicted) for r, f in zip(new, fresh, strict=True)
    )
    trial, chance = questions.answer(), questions.chance(np.random.default_rng(SEED))

    def place(family: Family | None, z: float, kind: str, gain: float, number: int) -> _Place:
        p = p_value(z, chance)
        driver = family.driver.name if family is not None and family.driver is not None else ""
        found = Finding(kind, driver, z, p, gain, "")
        one = _Place(found, plain, family, trial, number)
        return replace(one, finding=replace(found, sentence=_sentence(one, None, None, unit)))

    return [
        *(
            place(f, float(z), f.kind, h.gain, i)
            for i, (f, h, z) in enumerate(zip(families, trial.held, trial.z, strict=True))
        ),
        place(None, abs(trial.z_swing), SWING, 0.0, -1),
        place(None, abs(trial.z_begin), "begins", 0.0, -1),
    ]


def _sentence(
    place: _Place, response: ResponseAccount | None, curve: ResponseCurve | None, unit: str
) -> str:
    found, of = place.finding, unit or "phi"
    words = name_of(found.driver)
    if found.kind in _OF_RUNS:
        return _OF_RUNS[found.kind](place, of)
    if response is not None:
        more = f", changing with the {words}" if found.driver else ""
        return f"The reading follows that of the healthy vehicle {response.words}{more}."
    if curve is not None:
        low, high = float(curve.y.min()), float(curve.y.max())
        straight = curve.straight >= LIMITS.straight
        per = UNITS.get(found.driver, "unit")
        size = f"{plain(curve.slope, 3, '+')} {of} per {per}" if straight else "not in proportion"
        return (
            f"The reading changes with the {words}: {size}, {plain(low, 3, '+')} to "
            f"{plain(high, 3, '+')} {of}."
        )
    if found.kind == "dynamic":
        s = past_s(place.trial.held[place.number], place.runs[0].period_s)
        after = (
            f"half of it is gone after {s:.1f} s" if np.isfinite(s) else "it lasts a minute or more"
        )
        return f"The reading keeps a memory of changes of the {words}; {after}."
    return _PLAIN[found.kind] + (f" {words}." if found.driver else ".")


def _begins(place: _Place, of: str) -> str:
    runs, at = place.runs, place.trial.begins
    step = _mean(runs[at:]) - _mean(runs[:at]) if at else 0.0
    return f"From {runs[at].name} on the reading is {plain(step, 3, '+')} {of} off."


def _offset(place: _Place, of: str) -> str:
    off = float(place.trial.held[place.number].coefficients[0])
    return f"The reading is {plain(off, 3, '+')} {of} off everywhere."


_OF_RUNS: Final = {"begins": _begins, "offset": _offset}
_PLAIN: Final = {
    SWING: "The reading moves more or less than that of a healthy vehicle",
    "gain": "The reading moves more or less than in proportion",
    "timing": "The reading comes earlier or later",
    "lag": "The reading is slower or faster",
    "response": "The reading comes later, slower or in another proportion",
    "level": "The reading changes with the",
    "timing with": "The reading comes earlier or later, depending on the",
    "gain with": "The reading moves more or less, depending on the",
}


def _mean(runs: Sequence[Comparison]) -> float:
    return float(np.mean([r.residual[r.scored].mean() for r in runs]))
