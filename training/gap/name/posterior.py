"""Probabilities of all hypotheses about a gap: how often resampled blocks answer with each.

Blocks are drawn with replacement, and every draw is answered anew. Its answer is the candidate that
explains most of held-out blocks: more than healthy drives give it, and half of all that can be
explained. A gap that no candidate explains so is of another cause; there is one if the ceiling
explains more than chance. An effect with a sign that it cannot have is a hypothesis of its own.
Sources: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 8; Bühlmann,
Discussion of big Bayes stories and BayesBag, Statistical Science 29 (2014).
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.name.formulas.signal_screen import left_by_best_signal
from training.gap.name.ranking import USUAL_SHARE, WIN
from training.gap.name.verdict import Candidate
from training.healthy import scoring
from training.healthy.base_state import BaseState

NONE, UNKNOWN, ONSET = "none", "unknown", "onset"
GAP_GAIN: Final = 1000.0  # fall of the held-out deviance by the ceiling, from which there is a gap
GAP_T: Final = 4.0  # of the signed square roots of the blocks' falls
Posterior = Mapping[str, float]


def posterior(state: BaseState, ranking: Sequence[Candidate], whole: FloatArray) -> Posterior:
    """Return the probability of each candidate, of no gap and of another cause, sum 1.

    A candidate has to explain more than effects in the model usually leave, by another form.

    whole : deviance (n_blocks,) before any step, of which half is to be explained by all
    """
    drawn, after = scoring.draws(len(whole)), np.array([c.left for c in ranking])
    gains = drawn @ (state.deviance - after).T
    is_more = gains > USUAL_SHARE * (drawn @ state.own[:, np.newaxis] + gains)
    gains = np.where(is_more & (gains >= [c.merit.needed for c in ranking]), gains, 0.0)
    best, is_large = gains.argmax(axis=1), gains.max(axis=1) > 0.0
    counts = dict.fromkeys([*(c.label for c in ranking), NONE, UNKNOWN], 0)
    is_clear = _is_clear(state)
    counts[UNKNOWN if is_clear else NONE] = int((~is_large).sum())
    for i in np.unique(best[is_large]):
        candidate, own = ranking[i], drawn[is_large & (best == i)]
        # It leaves less than it explains; an effect in another form, the usual share of both.
        explained = own @ (whole - after[i])
        rest = own @ scoring.explained(candidate.fit, state.roof, state.case.blocks)
        holds = explained >= rest - USUAL_SHARE * (explained + rest)
        if candidate.kind == "sensor fault":
            # Its own fault may have another form, of which the library's explains a part.
            holds |= not is_clear or own @ left_by_best_signal(state) > own @ after[i]
        counts[candidate.label] = int(holds.sum())
        counts[UNKNOWN] += int((~holds).sum())
    return {name: count / len(drawn) for name, count in counts.items()}


def _is_clear(state: BaseState) -> bool:
    """Return whether the ceiling explains more of held-out blocks than it does of healthy ones."""
    known, errors, blocks = state.current.jacobian, state.current.residual, state.case.blocks
    rest = scoring.left_by(state.roof, known, errors, blocks)
    moved = np.bincount(blocks, (rest - errors) ** 2).astype(np.float64)
    score = scoring.score(scoring.by_block(errors, blocks), scoring.by_block(rest, blocks), moved)
    usual = USUAL_SHARE * (float(state.own.sum()) + score.gain)
    return score.gain >= max(GAP_GAIN, usual) and score.t >= GAP_T


def likely(odds: Posterior) -> list[str]:
    """Return the likeliest hypotheses, the first one first, as few as hold 95 % of all."""
    names = sorted(odds, key=lambda name: -odds[name])
    before = np.cumsum([0.0, *(odds[name] for name in names)])
    return [name for name, p in zip(names, before, strict=False) if p < WIN * before[-1]]


def on_top(first: Posterior, lead: str, then: Posterior, beaten: Posterior) -> Posterior:
    """Return the probabilities of two steps: ``lead`` of the first one alone, or with another.

    lead : the effects that the second step stands on, joined by +
    beaten : rivals of the first step → how often the second step explains more than they do
    Another cause than ``lead`` is a question of what stands beside it, so the second step says it.
    """
    others = {name: p for name, p in first.items() if name not in (lead, UNKNOWN)}
    both = {name: p * (1.0 - beaten.get(name, 0.0)) for name, p in others.items()}
    stands = 1.0 - sum(both.values())
    for name, p in then.items():
        label = {NONE: lead, UNKNOWN: UNKNOWN}.get(name, f"{lead}+{name}")
        both[label] = both.get(label, 0.0) + stands * p
    return both
