"""Whether the monitor still finds faults: put on the measured lambda, before two models.

The control loop has not seen these faults: in a car the controller would answer them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from monitor.base import config
from monitor.base.config import Config
from monitor.base.faults import Fault
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.side_by_side import Judged
from training.gap.inputs.roles import ACCEPTED
from training.gap.verify.evidence import Count, Detection
from training.limits.decision_limits import whole, with_limits
from training.limits.judging import judge_recordings
from training.limits.trust import put_on
from training.recordings.recording import Recording

Judge = Callable[[Sequence[Recording]], list[Judged]]


def monitor_of(model: Model, accepted: Sequence[Recording] = ()) -> Judge:
    """Return the monitor with a model and the limits of its card, and default settings.

    accepted : recordings to set the limits on instead, as those of a new model are, so that no
        code stands on them
    Raises ModelError if the card has no limits, RecordingError if they cannot be set.
    """
    settings: Config = config.load()
    card = model.card
    if accepted:
        card = with_limits(model, accepted, whole(accepted), settings, ACCEPTED)[0]
    limits = Limits.from_card(card, settings, str(model.path))
    return lambda recordings: judge_recordings(recordings, model, limits, settings)


@dataclass(frozen=True, slots=True)
class Monitors:
    """The monitor with the old and the new model."""

    old: Judge
    new: Judge | None = None
    alike: Judge | None = None  # the old model with limits set as the new one's


Trial = tuple[Sequence[Recording], Fault | None]  # None leaves the recordings as they are


def detect(trials: Sequence[Trial], monitors: Monitors) -> list[Detection]:
    """Return for each trial how often the monitor finds the fault, put on all its recordings.

    Without a fault, whatever is found is a false alarm. All trials run side by side.
    """
    faulty = [put_on(each, fault) if fault else each for given, fault in trials for each in given]
    before = monitors.old(faulty)
    after = monitors.new(faulty) if monitors.new else None
    alike = monitors.alike(faulty) if monitors.alike else None
    found, begin = [], 0
    for recordings, fault in trials:
        name, severity = (fault.name, fault.severity) if fault else ("", None)
        own = slice(begin, begin := begin + len(recordings))
        others = (None if each is None else _count(each[own], name) for each in (after, alike))
        found.append(Detection(name, severity, _count(before[own], name), *others))
    return found


def _count(judged: Sequence[Judged], fault: str) -> Count:
    names = [{dtc.fault for dtc in each.dtcs} for each in judged]
    return Count(
        drives=len(judged),
        judged=sum(each.completed or bool(each.dtcs) for each in judged),
        found=sum(bool(own) for own in names),
        named=sum(own == {fault} for own in names),
        codes=tuple(sorted(name for own in names for name in own)),
    )
