"""A recording through the monitor's own steps, without files or frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import starmap

import numpy as np

from monitor import enable
from monitor.config import Config
from monitor.dtc import Dtc, DtcStore
from monitor.enable import Enable
from monitor.limits import Limits
from monitor.model import Model
from monitor.model_card import ModelCard
from monitor.pipeline import Monitor, Tick, WindowJudged
from monitor.types import FloatArray, Sample
from training.recordings import Recording


@dataclass(frozen=True, slots=True)
class Judged:
    """What the monitor made of one recording."""

    measured: FloatArray  # (n,) output's unit
    predicted: FloatArray  # (n,) free run
    enabled: np.ndarray  # (n,) bool
    windows: list[WindowJudged]
    dtcs: list[Dtc]  # pending or confirmed at the end
    completed: bool


def enabled_samples(recording: Recording, card: ModelCard, config: Config) -> np.ndarray:
    """Return (n,) bool: samples on which all of the monitor's enable conditions hold."""
    names = _names(recording, card)
    conditions = Enable.of(config.enable, names, card)
    return np.array([all(conditions.step(s)) for s in _samples(recording, names)], dtype=np.bool_)


def _names(recording: Recording, card: ModelCard) -> list[str]:
    wanted = dict.fromkeys((*card.input_names, card.output.name, *enable.SIGNALS))
    return [name for name in wanted if name in recording.names]


def _samples(recording: Recording, names: list[str]) -> Iterator[Sample]:
    order = [recording.names.index(name) for name in names]
    values, quality = recording.values[:, order], recording.quality[:, order]
    times_ns = (np.arange(len(values)) * recording.period_ns).tolist()
    return starmap(Sample, zip(range(len(values)), times_ns, values, quality, strict=True))


def judge(recording: Recording, model: Model, limits: Limits, config: Config) -> Judged:
    """Return the monitor's verdict on one driving cycle with empty memory.

    Raises RecordingError if the model needs a signal that the recording lacks.
    """
    card = model.card
    names = _names(recording, card)
    store = DtcStore()
    store.start_driving_cycle()
    monitor = Monitor(model, limits, config, names, store)
    n = len(recording.values)
    predicted, enabled = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    windows: list[WindowJudged] = []
    for sample in _samples(recording, names):
        for event in monitor.push(sample):
            if isinstance(event, Tick):
                predicted[sample.index], enabled[sample.index] = event.predicted, event.enabled
            elif isinstance(event, WindowJudged):
                windows.append(event)
    measured = recording.column(card.output.name)
    return Judged(measured, predicted, enabled, windows, store.active, monitor.completed)
