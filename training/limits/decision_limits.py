"""Decision limits from healthy drives that the model, or its twin, has not seen."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from monitor.base.config import BiasConfig, Config
from monitor.base.counts import counted
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.judge.causes.causes import Cause
from monitor.judge.limits import NO_LIMITS, Limits, in_unit
from monitor.judge.window import oriented
from monitor.model.card import Limit, ModelCard
from monitor.pipeline.events import WindowJudged
from training.limits.judging import judge_recordings, why_not
from training.limits.response.response_limits import response_limits
from training.narx.model_file import Unseen
from training.recordings.recording import Recording

MINIMUM_WINDOWS = 10
PAPER_QUANTILE = 0.99
MOST_ROUNDS, CONVERGED = 1000, 1.0 - 1e-9  # of the spread of the offsets
MEMORY_MOST = 0.95  # correlation of the noise; above it a window holds almost no information


def limits_of(
    drives: Sequence[Sequence[WindowJudged]],
    card: ModelCard,
    config: Config,
    origin: str,
    recordings: Sequence[Recording],
) -> dict[str, Limit]:
    """Return all decision limits from the windows of healthy drives, name → limit.

    origin : description of the drives for the model card
    recordings : of the drives; if they have too few windows, the error says why
    Raises RecordingError if there are fewer than 10 windows.
    """
    windows = [window for drive in drives for window in drive]
    if len(windows) < MINIMUM_WINDOWS:
        blocked = defaultdict[tuple[Any, ...], list[Cause]](list)
        for cause in (cause for r in recordings for cause in why_not(r, card, config)[:1]):
            blocked[cause.condition, cause.signal].append(cause)
        driven = " with the vehicle warm and in closed loop" if card.transform == "phi" else ""
        told = f"give more or longer recordings{driven}"
        if most := max(blocked.values(), key=len, default=[]):
            told = f"{most[0].in_words} (in {len(most)} of {counted(len(recordings), 'part')})"
        number = counted(len(windows), "healthy window")
        raise RecordingError(f"{number}, {MINIMUM_WINDOWS} are wanted to set limits: {told}")
    # a drive unlike all others tells of itself, so the median one counts
    long = [drive for drive in drives if len(drive) >= MINIMUM_WINDOWS] or [windows]
    noise, memory = _noise(long, card.transform)
    offsets, offset_std = healthy_offsets(_counted(long, config), config.bias)
    j_mu, j_sigma = np.quantile([(abs(w.mean), w.std) for w in windows], PAPER_QUANTILE, axis=0)
    spread = max(6.0 * offset_std, 3.0 * math.sqrt(float(np.mean(np.square(offsets)))))
    floor = config.bias.offset_limit_lambda if card.transform == "phi" else 0.0
    where = f"{len(windows)} healthy windows, {origin}"
    quantile, unit = f"quantile {PAPER_QUANTILE}, {where}", card.output.unit
    phi = "-" if card.transform == "phi" else unit
    alike = f"correlation of the residual's neighbouring samples, {where}"
    means = "bounded spread of the median drive's window means"
    why = f"largest of {floor:g}, six times the {means} and three times that of the drives' offsets"
    return {
        "j_mu": Limit(float(j_mu), unit, quantile),
        "j_sigma": Limit(float(j_sigma), unit, quantile),
        "noise": Limit(noise, phi, f"residual within windows, median drive of {where}"),
        "noise_memory": Limit(memory, "-", alike),
        "offset": Limit(max(floor, spread), unit, f"{why}, {where}"),
        "offset_std": Limit(offset_std, unit, f"{means}, {where}"),
    }


def _counted(drives: Sequence[Sequence[WindowJudged]], config: Config) -> list[FloatArray]:
    """Return the means of the windows that count for the bias rule, one array a drive.

    These are the ones in which the reading moves. Where fewer than 10 do, all count.
    """
    still = config.plausibility.stuck_range
    moving = [[w for w in drive if np.ptp(w.window.measured) > still] for drive in drives]
    enough = sum(map(len, moving)) >= MINIMUM_WINDOWS
    return [np.array([w.mean for w in drive]) for drive in (moving if enough else drives) if drive]


def healthy_offsets(drives: Sequence[FloatArray], config: BiasConfig) -> tuple[list[float], float]:
    """Return the offset of each drive, and the spread of a window's mean around its drive's offset.

    drives : of each the means of its windows
    Both follow from each other, with windows that count for as much as in a decision (Huber, Robust
    Statistics, section 6.4, proposal 2). So a manoeuvre or two in which the model errs by far widen
    the spread no more than they delay a decision; where more than one window in 30 does, the model
    errs so as a rule, and all of its spread counts. The spread is that of the median drive.
    """
    counted, offsets, std = list(drives), list[float](), math.inf
    for _ in range(MOST_ROUNDS):
        offsets = [float(drive.mean()) for drive in counted]
        narrower = math.sqrt(float(np.median([drive.var() for drive in counted])))
        if narrower >= CONVERGED * std:
            break
        std = narrower
        most = config.certainty * std
        counted = [np.clip(d, at - most, at + most) for d, at in zip(drives, offsets, strict=True)]
    return offsets, std


def _noise(drives: Sequence[Sequence[WindowJudged]], transform: str) -> tuple[float, float]:
    """Return the median drive's standard deviation within windows, and its lag-1 correlation."""
    found = []
    for drive in drives:
        x = np.array([oriented(w.window.measured, transform) - w.window.bank[:, 0] for w in drive])
        x -= x.mean(axis=1, keepdims=True)
        power = float((x**2).sum())
        memory = float((x[:, 1:] * x[:, :-1]).sum()) / power if power > 0.0 else 0.0
        found.append((math.sqrt(power / x.size), memory))
    std, memory = np.median(found, axis=0)
    return float(std), min(max(float(memory), 0.0), MEMORY_MOST)


def with_limits(card: ModelCard, unseen: Unseen, origin: str, config: Config) -> ModelCard:
    """Return the model card with limits from healthy drives.

    unseen : models of the card's kind, each with drives that it has not seen, or that hardly
        changed it
    Raises RecordingError if there are fewer than 10 windows.
    """
    recordings = [drive for _, drives in unseen for drive in drives]
    runs = (judge_recordings(drives, model, NO_LIMITS, config) for model, drives in unseen)
    judged = [each for own in runs for each in own]
    config = in_unit(config, card)
    limits = limits_of([each.windows for each in judged], card, config, origin, recordings)
    card = replace(card, limits=limits, trust={})  # counted with other limits
    response = response_limits(judged, card, Limits.from_card(card, config, origin), config)
    return replace(card, limits={**limits, **response})
