"""Whether the monitor still finds faults: put on the measured lambda, before two models.

The control loop has not seen these faults: in a car the controller would answer them.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from monitor.base import config
from monitor.base.config import Config
from monitor.base.faults import Fault
from monitor.judge.limits import Limits
from monitor.model.step import Model
from training.gap.verify.evidence import Count, Detection
from training.limits.judging import Judged, judge_recordings
from training.recordings.recording import Recording
from training.recordings.sensor_fault import put_on

EVERY: Final = 3
Judge = Callable[[Sequence[Recording]], list[Judged]]


def monitor_of(path: Path) -> Judge:
    """Return the monitor with a model and the limits of its card, and default settings.

    Raises ModelError if the card has no limits.
    """
    settings: Config = config.load()
    model = Model.load(path)
    limits = Limits.from_card(model.card, settings, str(path))
    return lambda recordings: judge_recordings(recordings, model, limits, settings)


def detect(
    old: Judge, folds: Sequence[tuple[Judge | None, Sequence[Recording]]], faults: Sequence[Fault]
) -> list[Detection]:
    """Return how often the monitor finds no fault, then each fault, put on recordings.

    folds : recordings, with the monitor of the new model that judges them
    Without a fault, whatever is found is a false alarm. A fault is put on every third recording,
    the next one on the recordings before these.
    """
    every = min(EVERY, sum(len(recordings) for _, recordings in folds))
    trials: list[Fault | None] = [None, *faults]
    tried, given, after, first = list[int](), list[Recording](), list[Judged](), 0
    for new, recordings in folds:
        own = [
            (i, put_on(r, fault) if fault else r)
            for i, fault in enumerate(trials)
            for number, r in enumerate(recordings, first)
            if fault is None or (number + i) % every == 0
        ]
        tried += [i for i, _ in own]
        given += [r for _, r in own]
        after += new([r for _, r in own]) if new else []
        first += len(recordings)
    before = old(given)
    found = []
    for i, fault in enumerate(trials):
        rows = [k for k, trial in enumerate(tried) if trial == i]
        counts = [
            _count([runs[k] for k in rows], fault) if runs else None for runs in (before, after)
        ]
        found.append(Detection(*((fault.name, fault.severity) if fault else ("", None)), *counts))
    return found


def _count(judged: Sequence[Judged], fault: Fault | None) -> Count:
    names = [{dtc.fault for dtc in each.dtcs} for each in judged]
    return Count(
        drives=len(judged),
        judged=sum(each.completed or bool(each.dtcs) for each in judged),
        found=sum(bool(own) for own in names),
        named=sum(own == {fault.name if fault else ""} for own in names),
        codes=tuple(sorted(name for own in names for name in own)),
    )
