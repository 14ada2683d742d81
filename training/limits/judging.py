"""Judge recordings with the steps of the monitor, without files or frames."""

from collections.abc import Sequence

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, SampleBlock
from monitor.judge import enable
from monitor.judge.enable import Enable
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.side_by_side import Judged, judge_all
from training.recordings.recording import Recording

__all__ = ["Judged", "enabled_samples", "judge", "judge_recordings"]


def enabled_samples(recording: Recording, card: ModelCard, config: Config) -> BoolArray:
    """Return (n,) bool, True for samples at which all enable conditions hold."""
    names = _names(recording, card)
    conditions = Enable.of(config.enable, names, card).push(_block(recording, names).values)
    return np.asarray(conditions.all(axis=1))


def judge(recording: Recording, model: Model, limits: Limits, config: Config) -> Judged:
    """Return the verdict of a monitor with empty fault memory on one driving cycle.

    Raises RecordingError if the recording lacks an input of the model.
    """
    return judge_recordings([recording], model, limits, config)[0]


def judge_recordings(
    recordings: Sequence[Recording], model: Model, limits: Limits, config: Config
) -> list[Judged]:
    """Return the verdicts of ``judge`` on several recordings, in their order.

    Recordings with the same signals run side by side, faster than one by one.
    Raises RecordingError if a recording lacks an input of the model.
    """
    alike: dict[tuple[str, ...], list[int]] = {}
    for i, recording in enumerate(recordings):
        alike.setdefault(_names(recording, model.card), []).append(i)
    judged: dict[int, Judged] = {}
    for names, places in alike.items():
        blocks = [_block(recordings[i], names) for i in places]
        judged |= zip(places, judge_all(blocks, names, model, limits, config), strict=True)
    return [judged[i] for i in range(len(recordings))]


def _names(recording: Recording, card: ModelCard) -> tuple[str, ...]:
    wanted = dict.fromkeys((*card.input_names, card.output.name, *enable.SIGNALS))
    return tuple(name for name in wanted if name in recording.names)


def _block(recording: Recording, names: Sequence[str]) -> SampleBlock:
    """Return the named signals of a recording; its first sample has the time 0 s."""
    order = [recording.names.index(name) for name in names]
    index = np.arange(len(recording.values))
    return SampleBlock(
        index,
        index * recording.period_ns,
        recording.values[:, order],
        recording.quality[:, order],
    )
