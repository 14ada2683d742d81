"""A new model's healthy reference, learned from the recordings that it was fitted to.

It is of the physical chain even if the model is a network. A network leaves little of the samples
that it was trained on and several times as much of new healthy drives, also of those that its
held-out blocks are like; that would be named. The chain with what it misses is learned anew for
every group of drives left out, so what healthy drives show against each other is honest.
"""

from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from monitor.base.errors import RecordingError
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.greybox.fit.drive import ChainDrive
from training.healthy import base, yardstick
from training.healthy.card import store
from training.healthy.yardstick import GROUPS_LEAST
from training.jobs import Progress
from training.recordings.recording import Recording


def set_reference(
    path: Path, recordings: Sequence[Recording], progress: Progress = lambda _: None
) -> tuple[ModelCard, str | None]:
    """Put the healthy reference into the card of the model in ``path``.

    recordings : from which the model was fitted, of a healthy vehicle
    Returns the card and, if there is no reference though the model is one of lambda, why.
    """
    card = Model.load(path).card
    if card.transform != "phi":
        return card, None
    start = base.constants_of(card)
    drives, used, why = list[ChainDrive](), list[Recording](), ""
    for recording in recordings:
        try:
            drives += base.drives_of(path, [recording])
            used.append(recording)
        except RecordingError as error:
            why = f" ({error})"
    if len(drives) < GROUPS_LEAST:
        return card, (
            f"no healthy reference for o2train gap: {len(drives)} of {len(recordings)} recordings "
            f"can be used, {GROUPS_LEAST} are wanted{why}"
        )
    try:
        with threadpool_limits(1):  # many small matrices
            known = yardstick.learn(drives, start, progress)
    except RecordingError as error:
        return card, f"no healthy reference for o2train gap: {error}"
    return store(path, known, used), None
