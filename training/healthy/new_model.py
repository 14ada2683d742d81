"""What a new model's card keeps of the recordings: profile, decision limits, healthy reference."""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from monitor.base import config
from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.frames.profiles import profile as profiles
from monitor.grid.column_times import column_times
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.greybox.fit.drive import ChainDrive
from training.healthy import base, yardstick
from training.healthy.card import store
from training.healthy.yardstick import GROUPS_LEAST
from training.jobs import Progress
from training.limits.decision_limits import with_limits
from training.limits.trust import trust_of
from training.narx.export import update_card
from training.narx.model_file import FreeRunFit
from training.recordings.recording import Recording

ONE_RECORDING: Final = (
    "one recording does not show how drives differ, so the model may give a healthy sensor a code "
    "on another drive; train on several drives"
)


def complete(
    outcome: FreeRunFit,
    recordings: Sequence[Recording],
    columns: str | Path | None = None,
    progress: Progress = lambda _: None,
) -> tuple[ModelCard, tuple[str, ...]]:
    """Complete the card of the new model that a fit wrote; return it and warnings.

    columns : profile with which the recordings were read, so that the next log needs no option
    """
    path, settings, warnings = outcome.path, config.load(), list[str]()
    card = Model.load(path).card
    if columns is not None and profiles.is_profile(at := profiles.path_of(Path(columns))):
        card = replace(card, profile=tree_of(profiles.load_profile(at)))
    card = replace(card, times=_times(card, recordings, settings))
    unseen, origin = outcome.healthy()
    try:
        card = with_limits(card, unseen, origin, settings)
    except RecordingError as error:
        warnings.append(f"no decision limits: {error}")
    else:  # it knows what it finds and mistakes
        card = replace(card, trust=trust_of(unseen, card, settings, str(path)))
        if len({drive.path for _, drives in unseen for drive in drives}) == 1:
            warnings.append(ONE_RECORDING)
    update_card(path, card)
    card, doubt = set_reference(path, recordings, progress)
    return card, (*warnings, *([doubt] if doubt else []))


def _times(card: ModelCard, recordings: Sequence[Recording], settings: Config) -> dict[str, Any]:
    """Return when the logger writes the columns.

    How the reading is apart from the inputs is what the monitor judges, and so is what the ECU
    makes of the reading.
    """
    names = (*card.input_names, card.output.name)
    of_drives = (
        column_times(np.column_stack([*map(each.column, names)]), names, card.period_ns / 1e9)
        for each in recordings
    )
    return merged(of_drives, {*card.input_names} - {*settings.enable.range_ignored})


def set_reference(
    path: Path, recordings: Sequence[Recording], progress: Progress = lambda _: None
) -> tuple[ModelCard, str | None]:
    """Put the healthy reference into the card of the model in ``path``.

    It is of the physical chain even if the model is a network. A network leaves little of the
    samples that it was trained on and several times as much of new healthy drives, also of those
    that its held-out blocks are like; that would be named. The chain with what it misses is learned
    anew for every group of drives left out, so what healthy drives show against each other is
    honest.

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


def tree_of(profile: profiles.Profile) -> dict[str, Any]:
    """Return the tree from which ``profile_of`` makes the profile again, without based_on."""
    engine, tree = profile.engine, profiles.source_tree
    return {
        "title": profile.title,
        "stoich_afr": profile.stoich_afr,
        "time": [*map(tree, profile.time)],
        "signals": {name: [*map(tree, sources)] for name, sources in profile.signals.items()},
        "engine": {each.name: getattr(profile.engine, each.name) for each in fields(engine)},
        **({"pivot": profile.pivot._asdict()} if profile.pivot else {}),
    }


def merged(times: Iterable[Mapping[str, Any]], compared: Set[str]) -> dict[str, Any]:
    """Return the times of several recordings: longest intervals, ranges of what is apart.

    compared : names of the columns that are compared with each other
    """
    pairs = {f"{a} {b}" for a in compared for b in compared}  # names may have blanks
    every, apart = dict[str, float](), dict[str, list[float]]()
    for each in times:
        every |= {k: max(s, every.get(k, s)) for k, s in each["every_s"].items()}
        for pair, (low, high) in each["apart_s"].items():
            if pair in pairs:
                least, most = apart.get(pair, (low, high))
                apart[pair] = [min(least, low), max(most, high)]
    return {"every_s": every, "apart_s": apart}
