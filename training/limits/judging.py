"""Judge recordings with the steps of the monitor, without files or frames."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray, SampleBlock
from monitor.judge import enable
from monitor.judge.catalyst.watch import REAR
from monitor.judge.causes.causes import Asked, Cause, causes
from monitor.judge.causes.observation import Observation
from monitor.judge.electrical.suite import ElectricalTests
from monitor.judge.enable import Enable
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.names import needed_names
from training.limits.side_by_side import Judged, RecordingJudge
from training.recordings.recording import Recording


def enabled_samples(recording: Recording, card: ModelCard, config: Config) -> BoolArray:
    """Return (n,) bool, True for samples at which all enable conditions hold."""
    *_, held = _checked(recording, card, config)
    return np.asarray(held.all(axis=1))


def moving_samples(recording: Recording, card: ModelCard, config: Config) -> BoolArray:
    """Return (n,) bool, True for samples on which a live sensor's reading moves."""
    names, block, _, held = _checked(recording, card, config)
    burning = enable.holds(enable.masks(held), enable.BURNING)
    tests = ElectricalTests(config, names, card.output, card.period_ns * 1e-9)
    return tests.must_move(block.values, block.quality, burning)


def why_not(recording: Recording, card: ModelCard, config: Config) -> list[Cause]:
    """Return the signals and enable conditions that keep a recording from a verdict."""
    names, block, conditions, held = _checked(recording, card, config)
    observation = Observation(conditions, names, config.plausibility, card.period_ns * 1e-9)
    observation.push(block.values, block.quality, held)
    return causes(observation.observed(), Asked(card, config))


def most_common_cause(recordings: Sequence[Recording], card: ModelCard, config: Config) -> str:
    """Return the cause that keeps most recordings from windows, "" if there is none."""
    found = Counter(
        cause.in_words for recording in recordings for cause in why_not(recording, card, config)[:1]
    )
    most = found.most_common(1)
    return f"{most[0][0]} (in {most[0][1]} of {len(recordings)} recordings)" if most else ""


def judge(recording: Recording, model: Model, limits: Limits, config: Config) -> Judged:
    """Return the verdict of a monitor with empty fault memory on one driving cycle.

    What stands behind the catalyst is not judged.
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
        judge = RecordingJudge(names, model, limits, config)
        judged |= dict(zip(places, judge.judge(blocks), strict=True))
    return [judged[i] for i in range(len(recordings))]


def reached_twice(windows: Sequence[WindowJudged], name: str) -> float | None:
    """Return the largest value of a statistic that two successive windows of a drive reach.

    name : ``evidence`` for a faulty sensor, or ``offset_beyond``, the distance of the offset from
        the healthy range in standard deviations
    Return None if no two successive windows have the statistic.
    """
    values = [w.statistics.as_dict()[name] for w in windows]
    x = np.array([-np.inf if v is None else v for v in values], dtype=np.float64)
    best = float(np.minimum(x[1:], x[:-1]).max(initial=-np.inf))
    return best if np.isfinite(best) else None


def _checked(
    recording: Recording, card: ModelCard, config: Config
) -> tuple[tuple[str, ...], SampleBlock, Enable, BoolArray]:
    """Return names and samples of a recording, its conditions, and which held, (n, all)."""
    names = _names(recording, card)
    block, conditions = _block(recording, names), Enable.of(config.enable, names, card)
    return names, block, conditions, conditions.push(block.values, block.quality)


def _names(recording: Recording, card: ModelCard) -> tuple[str, ...]:
    return needed_names(card, [name for name in recording.names if name not in REAR])


def _block(recording: Recording, names: Sequence[str]) -> SampleBlock:
    """Return the named signals of a recording; its first sample has the time 0 s."""
    order = [recording.names.index(name) for name in names]
    index = np.arange(len(recording.values))
    values, quality = recording.values[:, order], recording.quality[:, order]
    return SampleBlock(index, index * recording.period_ns, values, quality)
