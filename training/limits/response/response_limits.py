"""Limits of the response rule from healthy recordings: gain, weight of evidence, stillness."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.optimize import brentq

from monitor.base.config import Config
from monitor.base.types import FloatArray
from monitor.judge.limits import Limits
from monitor.judge.response.estimates import Estimates
from monitor.model.card import Limit
from monitor.model.step import Model
from monitor.pipeline.events import CutJudged, WindowJudged
from training.limits.judging import Judged, judge_recordings
from training.limits.repeated_model import RepeatedModel
from training.limits.response.stillness import still_limits
from training.recordings.recording import Recording

Unseen = Iterable[tuple[Model, Sequence[Recording]]]  # models, each with drives it has not seen
LEAST_EVIDENCE: Final = 1e-3  # with less the response rule decides nothing within a day


def response_limits(
    model: Model,
    recordings: Sequence[Recording],
    limits: Limits,
    config: Config,
    unseen: Unseen | None = None,
) -> dict[str, Limit]:
    """Return the healthy gain, the weight of evidence and how long the reading may stand still.

    The gain's spread from drive to drive, and a model that follows its vehicle poorly, look like a
    weak or late sensor: evidence counts for so much that it speaks for no fault of healthy drives.
    A coarse or clipped reading that stands still in healthy recordings is given more time before
    it is stuck.

    limits : of the windows; what an earlier calibration says of the response does not count
    unseen : tell the weight; default this model and all recordings
    """
    where = f"{len(recordings)} healthy recordings"
    plain = replace(limits, still_s=0.0, still_end_s=0.0, gain_model=1.0, evidence=1.0)
    judged = judge_recordings(recordings, model, plain, config)
    gains = [gain for each in judged if (gain := _last_gain(each.windows)) is not None]
    gain = _healthy_gain(gains, config)
    used = replace(plain, gain_model=gain)
    # what is cut off below would hide how much speaks for a sound sensor
    endless = replace(config, response=replace(config.response, evidence_most=np.inf))
    pairs = list(unseen or ())
    drives = [
        _evidence(each)
        for runs, own in pairs or [(model, recordings)]
        for each in judge_recordings(own, RepeatedModel.of(runs), used, endless)
    ]
    weight = weight_of(drives, config.response.evidence_window)
    told = f"most at which a bet on a fault does not win, {len(drives)} healthy recordings"
    found = {
        "gain_model": Limit(gain, "-", f"median gain of the likeliest sound sensor, {where}"),
        "evidence": Limit(weight, "-", f"{told} that the model had not seen" if pairs else told),
    }
    return found | still_limits(recordings, model.card, config)


def weight_of(drives: Sequence[FloatArray], most: float) -> float:
    """Return the weight of evidence at which a bet on the likeliest fault does not win on average.

    The weight times the evidence is the logarithm of a stake; where its mean factor is at most 1,
    no healthy drive ever reaches the odds 1/alpha with a probability above alpha (Ville; Dey,
    Martin and Williams, Generalized universal inference on risk minimizers, arXiv 2402.00202).

    drives : evidence of the likeliest fault after each window, of healthy drives
    most : evidence of a window; one that says so much of a fault is imagined beside those seen

    >>> round(weight_of([np.cumsum([-1.0, 0.5] * 200)], 5.8), 2)
    0.54
    """
    steps = np.concatenate([[most], *(np.diff(drive, prepend=0.0) for drive in drives)])

    def gains(weight: float) -> float:
        return float(np.exp(weight * steps).mean()) - 1.0

    if gains(LEAST_EVIDENCE) >= 0.0:
        return LEAST_EVIDENCE
    return 1.0 if gains(1.0) <= 0.0 else float(brentq(gains, LEAST_EVIDENCE, 1.0))


def _healthy_gain(gains: Sequence[float], config: Config) -> float:
    """Return the median of the drives' gains, 1 without any."""
    least = config.response.gain_least  # a model that follows less says nothing of its vehicle
    return min(max(float(np.median(gains)), least), 1.0 / least) if gains else 1.0


def _evidence(judged: Judged) -> FloatArray:
    """Return the evidence of the likeliest fault after each window of either kind, (w,)."""
    seen = [(w.window.t_end_ns, _estimates(w)) for w in judged.windows]
    seen += [(cut.t_ns, _estimates(cut)) for cut in judged.cuts]
    return np.array([each.evidence for _, each in sorted(seen, key=lambda at: at[0])])


def _last_gain(windows: Sequence[WindowJudged]) -> float | None:
    return _estimates(windows[-1]).gain if windows else None


def _estimates(judged: WindowJudged | CutJudged) -> Estimates:
    found = judged.statistics
    return found if isinstance(found, Estimates) else found.response
