"""Limits of the response rule from healthy recordings: gains, movement, weights of evidence."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.base.config import Config
from monitor.judge.limits import Limits
from monitor.model.card import Limit
from monitor.model.step import Model
from monitor.pipeline.events import CutJudged, WindowJudged
from training.limits.judging import Judged, judge_recordings
from training.limits.movement import movement_of
from training.limits.stillness import still_limits
from training.recordings.recording import Recording

EVIDENCE_SAFETY = 3.0  # times the healthy recordings' largest evidence of a fault, for a code
WINDOWS_OF_A_CODE = 2  # must speak for a fault where healthy recordings show evidence of one
STEPS = (0.5, 0.8)  # of a weight that is still too large, at least and at most
LEAST_EVIDENCE = 1e-3  # with less the response rule decides nothing within a day


def response_limits(
    model: Model,
    recordings: Sequence[Recording],
    limits: Limits,
    config: Config,
    *,
    seen: bool = False,
) -> dict[str, Limit]:
    """Return the healthy gains, the weights of evidence and how long the reading may stand still.

    The gain's spread from drive to drive, and a model that follows its vehicle poorly, look like a
    weak or late sensor; then no window alone may say more than half of what a code needs, and the
    evidence counts less by as much as the recordings still say so. Windows around fuel cuts have a
    gain and a weight of their own; the weight is 0 without such windows. A coarse or clipped
    reading that stands still in healthy recordings is given more time before it is stuck.

    One recording shows neither how the gain spreads nor the errors that a model has for a whole
    other drive, least of all the recording that trained it. So windows are bound in any case, and
    the reading of a weak sensor must also move less.

    seen : the other limits are of windows that trained the model; the same holds for it
    """
    where = f"{len(recordings)} healthy recordings"
    is_blind = seen or len(recordings) == 1
    full = config.response.evidence_weight
    plain = replace(limits, gain_model=1.0, evidence=math.inf, evidence_cut=full, gain_cut=1.0)
    unbound = 2.0 * config.response.evidence_most  # from its lead to the last place
    plain = replace(plain, evidence_window=unbound)
    judged = judge_recordings(recordings, model, plain, config)
    gain = _healthy_gain([_last_gain(each.windows) for each in judged], config)
    used = replace(limits, gain_model=gain, evidence=full, evidence_cut=0.0)
    used = replace(used, evidence_window=unbound)
    most = _most_evidence(model, recordings, used, config)
    if is_blind or most > _allowed(config):
        used = replace(used, evidence_window=config.response.evidence_fail / WINDOWS_OF_A_CODE)
        used, _ = _calmed(model, recordings, used, "evidence", config)
    movement = 0.0
    if is_blind:
        windows = [window for each in judged for window in each.windows]
        movement = movement_of(windows, model.card.transform, limits.noise_memory)
    found = {
        "gain_model": Limit(gain, "-", f"median gain of the likeliest sound sensor, {where}"),
        "evidence": Limit(
            used.evidence, "-", f"largest evidence of a fault {most:.3g} at full weight, {where}"
        ),
        "evidence_window": Limit(
            used.evidence_window,
            "-",
            f"half of a code's evidence where {where} show more than a third or are "
            "too few, else no bound",
        ),
        "movement": Limit(
            movement,
            "-",
            f"spread of the reading over that of the prediction in {where}"
            if is_blind
            else f"not needed, {where} show how gains differ",
        ),
    }
    found |= still_limits(recordings, model.card, config)
    return found | _around_cuts(model, recordings, judged, used, config)


def _around_cuts(
    model: Model,
    recordings: Sequence[Recording],
    judged: Sequence[Judged],
    used: Limits,
    config: Config,
) -> dict[str, Limit]:
    """Return gain, noise and weight of windows around fuel cuts; nothing without such windows."""
    n_cuts = sum(len(each.cuts) for each in judged)
    if not n_cuts:
        return {}
    gain = _healthy_gain([_last_gain(each.cuts) for each in judged], config)
    unit = "-" if model.card.transform == "phi" else model.card.output.unit
    noise = _noise_of_edges([cut for each in judged for cut in each.cuts], used.excitation)
    full = config.response.evidence_weight
    used = replace(used, gain_cut=gain, noise_cut=noise, evidence_cut=full)
    used, most = _calmed(model, recordings, used, "evidence_cut", config)
    where = f"{n_cuts} windows around fuel cuts of {len(recordings)} healthy recordings"
    return {
        "gain_cut": Limit(gain, "-", f"median gain of the likeliest sound sensor, {where}"),
        "noise_cut": Limit(noise, unit, f"median spread of the residual at edges, {where}"),
        "evidence_cut": Limit(
            used.evidence_cut,
            "-",
            f"largest evidence of a fault {most:.3g} at full weight, {where}",
        ),
    }


def _noise_of_edges(cuts: Sequence[CutJudged], excitation: float) -> float:
    """Return the median spread of the residual over windows that hold an edge, if any does.

    Within a long cut, reading and prediction rest in air: such windows tell nothing of the model's
    error at an edge, and may be most of them.
    excitation : standard deviation from which the prediction moves
    """
    edges = [cut.std for cut in cuts if float(cut.statistics["excitation"] or 0.0) >= excitation]
    return float(np.median(edges or [cut.std for cut in cuts]))


def _healthy_gain(gains: Sequence[float | None], config: Config) -> float:
    """Return the median of the drives' gains, 1 without any."""
    known = [gain for gain in gains if gain is not None]
    least = config.response.gain_least  # a model that follows less says nothing of its vehicle
    return min(max(float(np.median(known)), least), 1.0 / least) if known else 1.0


def _weighted(limits: Limits, name: str, weight: float) -> Limits:
    if name == "evidence_cut":
        return replace(limits, evidence_cut=weight)
    return replace(limits, evidence=weight)


def _calmed(
    model: Model,
    recordings: Sequence[Recording],
    limits: Limits,
    name: str,
    config: Config,
) -> tuple[Limits, float]:
    """Return limits with which healthy recordings stay well below a code; their evidence before.

    The weight is lowered. Evidence that the recordings show with the least weight, too, comes from
    other windows.
    """
    most = before = _most_evidence(model, recordings, limits, config)
    if most <= _allowed(config):
        return limits, before
    others = _most_evidence(model, recordings, _weighted(limits, name, LEAST_EVIDENCE), config)
    allowed, weight = max(_allowed(config), others), config.response.evidence_weight
    while most > allowed and weight > LEAST_EVIDENCE:  # evidence has bounds, so it is not linear
        weight *= float(np.clip(allowed / most, *STEPS))
        limits = _weighted(limits, name, weight)
        most = _most_evidence(model, recordings, limits, config)
    return limits, before


def _allowed(config: Config) -> float:
    """Return the largest evidence of a fault that healthy recordings may show."""
    return config.response.evidence_fail / EVIDENCE_SAFETY


def _most_evidence(
    model: Model, recordings: Sequence[Recording], limits: Limits, config: Config
) -> float:
    """Return the largest evidence of a fault in any window of healthy recordings."""
    found = [0.0]
    for judged in judge_recordings(recordings, model, limits, config):
        for windows in (judged.windows, judged.cuts):
            found += [float(window.statistics["evidence"] or 0.0) for window in windows]
    return max(found)


def _last_gain(windows: Sequence[WindowJudged | CutJudged]) -> float | None:
    gain = windows[-1].statistics["gain"] if windows else None
    return float(gain) if isinstance(gain, float) else None
