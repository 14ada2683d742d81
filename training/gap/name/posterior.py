"""Probabilities of all hypotheses about a gap.

Two steps, each with its own temperature: is there a gap at all, and which hypothesis is it.
Neighbouring samples share more than the noise model knows, so evidence counts less than it says.
Candidates of the library compete on held-out blocks: by how much the best explains more, over the
spread of that between blocks.
Sources: Guo, Pleiss, Sun, Weinberger, On calibration of modern neural networks, ICML 2017; Vehtari,
Gelman, Gabry, Practical Bayesian model evaluation, Statistics and Computing 27 (2017), section 5.1.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.config import CONFIG
from training.gap.name.hypotheses import MOVED, NONE, UNKNOWN, GapHypothesis

LIMITS: Final = CONFIG.name
FARTHEST: Final = 50.0  # log odds beyond which nothing changes


def posterior(found: Sequence[GapHypothesis]) -> dict[str, float]:
    """Return the probability of every hypothesis and of no gap, the likeliest first; sum 1."""
    logs = np.array([_log_weight(each, _best(found)) for each in found])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    nats = max(each.nats / each.scale for each in found)
    odds = (nats - LIMITS.gap_nats) / LIMITS.gap_temperature
    gap = 1.0 / (1.0 + float(np.exp(-np.clip(odds, -FARTHEST, FARTHEST))))
    every = {each.name: gap * float(p) for each, p in zip(found, shares, strict=True)}
    every[NONE] = 1.0 - gap
    return dict(sorted(every.items(), key=lambda item: -item[1]))


def _best(found: Sequence[GapHypothesis]) -> GapHypothesis | None:
    """Return the candidate that explains most of held-out blocks."""
    tried = [(float(e.deviance.sum()), i) for i, e in enumerate(found) if e.deviance is not None]
    return found[min(tried)[1]] if tried else None


def _log_weight(each: GapHypothesis, best: GapHypothesis | None) -> float:
    prior = _prior(each)
    if best is None or best.deviance is None:
        return each.nats / LIMITS.rival_temperature + prior
    if each.deviance is None:
        return (each.nats - best.nats) / LIMITS.rival_temperature + prior
    return prior - LIMITS.rival_t * _t(each.deviance, best.deviance)


def _t(deviance: FloatArray, best: FloatArray) -> float:
    """Return by how much held-out blocks prefer the best, over the spread of that."""
    lost = (deviance - best) / 2.0
    spread = np.hypot(np.sqrt(len(lost)) * lost.std(), LIMITS.rival_spread_nats)
    return float(lost.sum() / spread)


def _prior(each: GapHypothesis) -> float:
    if each.name == UNKNOWN:
        return LIMITS.log_prior_unknown
    if each.began is not None:
        return LIMITS.log_prior_onset - float(np.log(each.began.among))
    if each.name == MOVED:
        return LIMITS.log_prior_moved
    # A factor on the mixture is an effect of the library, whatever it counts as.
    return LIMITS.log_prior_fault if each.is_fault else 0.0
