"""How a model errs, from healthy recordings: amplitude, weights of evidence."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from operator import attrgetter
from typing import Final

import numpy as np
from scipy.optimize import brentq

from monitor.base.config import Config
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.decision.window_facts import phi_of
from monitor.judge.limits import Limits
from monitor.judge.response.rule import Moments, ResponseRule
from monitor.judge.window import Window
from monitor.model.card import Limit, ModelCard
from training.limits.judging import Judged

LEAST_EVIDENCE: Final = 1e-3  # with less the response rule decides nothing within a day
GAIN_MOST: Final = 10.0  # of a model that follows its vehicle, and its inverse


def response_limits(
    healthy: Sequence[Judged], card: ModelCard, limits: Limits, config: Config
) -> dict[str, Limit]:
    """Return how models err on drives that they have not seen.

    A model's errors look like a weak or late sensor: evidence counts for so much that it speaks for
    no fault of healthy drives.

    limits : of the windows; what an earlier calibration says of the response does not count
    """
    own, period_s = config.response, card.period_ns / 1e9
    rule = ResponseRule(own, limits, period_s)
    moving = (_moving(judged, config.plausibility.stuck_range) for judged in healthy)
    drives = [_moments(windows, rule, card.transform) for windows in moving if windows]
    gain = healthy_gain(drives, limits, own.noise_least)
    plain = replace(limits, gain_model=gain, evidence=1.0, evidence_gain=1.0)
    steps = [_steps(moments, ResponseRule(own, plain, period_s)) for moments in drives]
    late, weak = ([each[part] for each in steps] for part in (0, 1))
    still = 2.0 * math.log(own.gain_sound_min / own.gain_least)
    where = f"{len(drives)} healthy recordings"
    bet = f"most at which a bet on a fault does not win on {where}"
    return {
        "gain_model": Limit(gain, "-", f"amplitude over the prediction's, median window, {where}"),
        "evidence": Limit(weight_of(late, own.evidence_window), "-", bet),
        "evidence_gain": Limit(weight_of(weak, still), "-", bet),
    }


def weight_of(drives: Sequence[FloatArray], most: float) -> float:
    """Return the weight of evidence at which a bet on a fault does not win on average, above 0.

    The weight times the evidence is the logarithm of a stake; where its mean factor is at most 1,
    no healthy drive ever reaches the odds 1/alpha with a probability above alpha (Ville; Dey,
    Martin and Williams, Generalized universal inference on risk minimizers, arXiv 2402.00202).

    drives : of each healthy drive by how much every window raises the evidence of a fault
    most : evidence of a window; one that says so much of a fault is imagined beside those seen

    >>> round(weight_of([np.array([-1.0, 0.5] * 200)], 5.8), 2)
    0.54
    """
    steps = np.concatenate([[most], *drives])

    def wins(weight: float) -> float:
        return float(np.exp(weight * steps).mean()) - 1.0

    certain = np.log(len(steps)) / most  # with which the imagined window alone wins
    if not wins(LEAST_EVIDENCE) < 0.0:
        return LEAST_EVIDENCE
    return float(brentq(wins, LEAST_EVIDENCE, certain))


def healthy_gain(drives: Sequence[Moments], limits: Limits, noise_least: float) -> float:
    """Return the amplitude of healthy readings over the prediction's: that of the median window.

    Windows count by how much of the reading's variance the prediction gives.
    """
    if not drives:
        return 1.0
    predicted = np.concatenate([moments.sxx[:, 0] for moments in drives])
    measured = np.concatenate([moments.syy for moments in drives])
    measured += noise_least * limits.innovation_var

    def median(log_gain: float) -> float:
        moved = np.exp(2.0 * log_gain) * predicted
        whole = moved + limits.innovation_var
        ratio = np.log(measured / whole)
        order = np.argsort(ratio)
        total = np.cumsum((moved / whole)[order])
        return float(ratio[order[np.searchsorted(total, 0.5 * total[-1])]])

    most = math.log(GAIN_MOST)
    if not median(-most) > 0.0 > median(most):
        return 1.0
    return math.exp(brentq(median, -most, most, xtol=1e-9))


def _moving(judged: Judged, still: float) -> list[Window]:
    """Return a drive's windows of either kind in their order, without those that are ignored."""
    windows = [each.window for each in judged.windows] + [cut.window for cut in judged.cuts]
    moving = (window for window in windows if np.ptp(window.measured) > still)
    return sorted(moving, key=attrgetter("t_end_ns"))


def _moments(windows: Sequence[Window], rule: ResponseRule, transform: str) -> Moments:
    groups = (list(group) for _, group in groupby(windows, attrgetter("is_cut")))
    found = [rule.regressed(phi_of(own, transform), [w.bank for w in own]) for own in groups]
    return Moments._make(np.concatenate(each) for each in zip(*found, strict=True))


def _steps(moments: Moments, rule: ResponseRule) -> tuple[FloatArray, FloatArray]:
    """Return by how much each window raises the evidence of a late and of a weak sensor, (w,).

    Late is a lag or dead time beyond its limit against any within it, whatever the gain; weak a
    punctual sensor of little gain against one that is sound.
    """
    is_late = np.array([claim.hypothesis.beyond_limit for claim in rule.claims])
    is_sound = np.array([not claim.fault for claim in rule.claims])
    punctual = np.array([claim.column == 0 for claim in rule.claims])
    said = rule.said(moments)

    def raised(added: FloatArray, fault: BoolArray, sound: BoolArray) -> FloatArray:
        summed = np.cumsum(added, axis=0)
        margin = summed[:, fault].max(axis=1) - summed[:, sound].max(axis=1)
        return np.diff(margin, prepend=0.0)

    late = rule.weighted(said._replace(gain=np.zeros_like(said.gain)))
    weak = rule.weighted(said._replace(timing=np.zeros_like(said.timing)))
    return raised(late, is_late, is_sound), raised(weak, punctual & ~is_sound, punctual & is_sound)
