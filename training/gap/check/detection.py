"""Whether the monitor still finds faults: put on the measured lambda, before two models.

The control loop has not seen these faults: in a car the controller would answer them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor import config
from monitor.batch.judge import Judged
from monitor.config import Config
from monitor.faults import Fault, SensorFault, resolve
from monitor.limits import Limits
from monitor.model import Model
from training.gap.check.verified import Count, Found
from training.gap.drives import OUTPUT
from training.judge import judge_recordings
from training.matrix.targets import LIMIT_SEVERITY
from training.recordings import Recording

BIAS_LAMBDA: Final = 0.1  # found without the vehicle's own reference; the limit of 0.05 needs one
FAULTS: Final = tuple(
    resolve(name, BIAS_LAMBDA if name.startswith("biased") else severity)
    for name, severity in LIMIT_SEVERITY.items()
    if name != "transient"  # lag and gain together: both are there by themselves
)
Judge = Callable[[Sequence[Recording]], list[Judged]]


def monitor_of(path: Path) -> Judge:
    """Return the monitor with a model file and the limits of its card, and default settings.

    Raises ModelError if the card has no limits.
    """
    settings: Config = config.load()
    model = Model.load(path)
    limits = Limits.from_card(model.card, settings, str(path))
    return lambda recordings: judge_recordings(recordings, model, limits, settings)


def put_on(recording: Recording, fault: Fault) -> Recording:
    """Return the recording as a faulty sensor would have read the same mixture."""
    values, column = recording.values.copy(), recording.names.index(OUTPUT)
    sensor = SensorFault(fault, recording.period_ns / 1e9)
    values[:, column] = np.array(sensor.apply(values[:, column].tolist()))
    return replace(recording, values=values)


def alarms(recordings: Sequence[Recording], old: Judge, new: Judge | None) -> Found:
    """Return what the monitor says of recordings as they are."""
    after = None if new is None else _count(new(recordings), "")
    return Found("", None, _count(old(recordings), ""), after)


def detect(
    recordings: Sequence[Recording], faults: Sequence[Fault], old: Judge, new: Judge | None
) -> tuple[Found, ...]:
    """Return how often each fault is found, put on each of the recordings."""
    faulty = [put_on(recording, fault) for fault in faults for recording in recordings]
    n = len(recordings)
    before = old(faulty)
    after = None if new is None else new(faulty)
    return tuple(
        Found(
            fault.name,
            fault.severity,
            _count(before[i * n : (i + 1) * n], fault.name),
            None if after is None else _count(after[i * n : (i + 1) * n], fault.name),
        )
        for i, fault in enumerate(faults)
    )


def _count(judged: Sequence[Judged], fault: str) -> Count:
    names = [{dtc.fault for dtc in each.dtcs} for each in judged]
    return Count(
        len(judged),
        sum(each.completed or bool(each.dtcs) for each in judged),
        sum(bool(own) for own in names),
        sum(own == {fault} for own in names),
        tuple(sorted(name for own in names for name in own)),
    )
