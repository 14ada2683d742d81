"""A recording through the monitor's own steps, without files or frames."""

from dataclasses import dataclass
from itertools import starmap

import numpy as np

from monitor import enable
from monitor.config import Config
from monitor.dtc import Dtc, DtcStore
from monitor.limits import Limits
from monitor.model import Model
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


def judge(recording: Recording, model: Model, limits: Limits, config: Config) -> Judged:
    """Return the monitor's verdict on one driving cycle with empty memory.

    Raises RecordingError if the model needs a signal that the recording lacks.
    """
    card = model.card
    wanted = dict.fromkeys((*card.input_names, card.output.name, *enable.SIGNALS))
    names = [name for name in wanted if name in recording.names]
    order = [recording.names.index(name) for name in names]
    store = DtcStore()
    store.start_driving_cycle()
    monitor = Monitor(model, limits, config, names, store)
    values, quality = recording.values[:, order], recording.quality[:, order]
    n = len(values)
    predicted, enabled = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    windows: list[WindowJudged] = []
    times_ns = (np.arange(n) * recording.period_ns).tolist()
    samples = zip(range(n), times_ns, values, quality, strict=True)
    for sample in starmap(Sample, samples):
        for event in monitor.push(sample):
            if isinstance(event, Tick):
                predicted[sample.index], enabled[sample.index] = event.predicted, event.enabled
            elif isinstance(event, WindowJudged):
                windows.append(event)
    measured = recording.column(card.output.name)
    return Judged(measured, predicted, enabled, windows, store.active, monitor.completed)
