"""Limits of the response rule from healthy recordings: gains, movement, weights of evidence."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.base.config import Config
from monitor.judge.limits import Limits
from monitor.judge.response.estimates import Estimates
from monitor.model.card import Limit
from monitor.model.step import Model
from monitor.pipeline.events import CutJudged, WindowJudged
from training.limits.judging import judge_recordings
from training.limits.response.stillness import still_limits
from training.recordings.recording import Recording

CODE_PROBABILITY = 0.003  # at most, of a code's evidence in a healthy drive like the recordings
PROMISED = 1.0  # mean of a healthy drive's largest evidence, if the errors are the noise supposed
WINDOWS_OF_A_CODE = 2  # must speak for a fault where healthy recordings show evidence of one
STEPS = (0.5, 0.8)  # of a weight that is still too large, at least and at most
LEAST_EVIDENCE = 1e-3  # with less the response rule decides nothing within a day


def response_limits(
    model: Model,
    recordings: Sequence[Recording],
    limits: Limits,
    config: Config,
) -> dict[str, Limit]:
    """Return the healthy gains, the weights of evidence and how long the reading may stand still.

    The gain's spread from drive to drive, and a model that follows its vehicle poorly, look like a
    weak or late sensor. Where healthy recordings show more evidence of a fault than the noise
    supposed would, no window alone may say more than half of a code's evidence, and the evidence
    counts less by as much as a code would still be too probable in another healthy drive
    (``_probability``). A coarse or clipped reading that stands still in healthy recordings is
    given more time before it is stuck.

    limits : of the windows; what an earlier calibration says of the response does not count
    """
    where = f"{len(recordings)} healthy recordings"
    unbound = 2.0 * config.response.evidence_most  # beyond that of the settings
    plain = replace(limits, still_s=0.0, still_end_s=0.0, evidence_window=unbound)
    plain = replace(plain, gain_model=1.0, evidence=math.inf)
    judged = judge_recordings(recordings, model, plain, config)
    gains = [gain for each in judged if (gain := _last_gain(each.windows)) is not None]
    gain = _healthy_gain(gains, config)
    used = replace(plain, gain_model=gain, evidence=config.response.evidence_weight)
    most = _most_evidence(model, recordings, used, config)
    if _scale(most) > PROMISED:
        used = replace(used, evidence_window=config.response.evidence_fail / WINDOWS_OF_A_CODE)
        used = _calmed(model, recordings, used, config)
    found = {
        "gain_model": Limit(gain, "-", f"median gain of the likeliest sound sensor, {where}"),
        "evidence": Limit(used.evidence, "-", _origin(most, where)),
        "evidence_window": Limit(
            used.evidence_window,
            "-",
            f"half of a code's evidence where {where} show more evidence of a fault than noise "
            "would, else only that of the settings",
        ),
    }
    return found | still_limits(recordings, model.card, config)


def _healthy_gain(gains: Sequence[float], config: Config) -> float:
    """Return the median of the drives' gains, 1 without any."""
    least = config.response.gain_least  # a model that follows less says nothing of its vehicle
    return min(max(float(np.median(gains)), least), 1.0 / least) if gains else 1.0


def _origin(most: Sequence[float], where: str) -> str:
    return f"largest evidence of a fault {max(most):.3g} at full weight, {where}"


def _calmed(
    model: Model, recordings: Sequence[Recording], limits: Limits, config: Config
) -> Limits:
    """Return limits whose weight makes a code in a healthy drive improbable."""
    most = _most_evidence(model, recordings, limits, config)
    if _probability(most, config) <= CODE_PROBABILITY:
        return limits
    allowed = -config.response.evidence_fail / math.log(CODE_PROBABILITY)
    weight = config.response.evidence_weight
    while _scale(most) > allowed and weight > LEAST_EVIDENCE:  # bounded evidence is not linear
        weight *= float(np.clip(allowed / _scale(most), *STEPS))
        limits = replace(limits, evidence=weight)
        most = _most_evidence(model, recordings, limits, config)
    return limits


def _probability(most: Sequence[float], config: Config) -> float:
    """Return the probability that another healthy drive shows the evidence of a code.

    most : largest evidence of a fault in each healthy drive, which falls off exponentially
    Source: Basseville and Nikiforov, Detection of Abrupt Changes, section 5.2 (the exceedance of a
    level by a sum of log likelihood ratios falls exponentially with the level).
    """
    scale = _scale(most)
    return math.exp(-config.response.evidence_fail / scale) if scale else 0.0


def _scale(most: Sequence[float]) -> float:
    """Return the mean of exponentially distributed values, from their mean or their largest one.

    The larger of both estimates, in case that a few drives are worse than the others. The largest
    of n values is 1 + 1/2 + … + 1/n times the mean (David and Nagaraja, Order Statistics, section
    2.5).
    """
    largest = max(most) / sum(1.0 / k for k in range(1, len(most) + 1))
    return max(math.fsum(most) / len(most), largest)


def _most_evidence(
    model: Model, recordings: Sequence[Recording], limits: Limits, config: Config
) -> list[float]:
    """Return the largest evidence of a fault in each healthy recording with windows, at least 0."""
    found = []
    for judged in judge_recordings(recordings, model, limits, config):
        seen: list[WindowJudged | CutJudged] = [*judged.windows, *judged.cuts]
        evidence = [_estimates(each).evidence for each in seen]
        if evidence:  # a drive without windows does not show that the evidence is small
            found.append(max(0.0, *evidence))
    return found or [0.0]


def _last_gain(windows: Sequence[WindowJudged | CutJudged]) -> float | None:
    return _estimates(windows[-1]).gain if windows else None


def _estimates(judged: WindowJudged | CutJudged) -> Estimates:
    found = judged.statistics
    return found if isinstance(found, Estimates) else found.response
