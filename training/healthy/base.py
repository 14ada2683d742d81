"""The model under study as the naming sees it: the chain on the charge that the model sees."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.greybox.chain import Constants, simulate
from training.greybox.charge import ChargeError, ChargeMap
from training.greybox.fit.drive import OUTPUT, ChainDrive, from_recording
from training.greybox.graph.chain_difference import ChainDifference
from training.greybox.graph.chain_graph import Greybox
from training.greybox.graph.effect_inputs import seeing
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording
from training.recordings.samples.rows import hold

GREYBOX: Final = "greybox"


def check(model: Path) -> ModelCard:
    """Return the card of a model that the workflow can extend.

    Raises ModelError if the model does not predict lambda by way of phi.
    """
    card = Model.load(model).card
    if card.transform != "phi":
        raise ModelError(
            f"{model}: predicts {card.output.name} as it is; the gap workflow wants a model of "
            "lambda_measured from o2train fit"
        )
    return card


def card_of(model: Path) -> ModelCard:
    """Return the card of a model that the workflow can compare with recordings.

    Raises ModelError if it predicts lambda, but not by way of phi.
    """
    card = Model.load(model).card
    return card if card.output.name != OUTPUT else check(model)


def constants_of(card: ModelCard) -> Constants:
    """Return a grey-box model's constants, usual ones for a network."""
    return Greybox.of(card).constants if card.kind == GREYBOX else Constants()


def own_charge(card: ModelCard) -> bool:
    """Return whether the model makes the air per stroke of other signals."""
    return card.kind == GREYBOX and isinstance(Greybox.of(card).charge, ChargeMap)


def drives_of(
    model: Path, recordings: Sequence[Recording], healthy: Sequence[Recording] = ()
) -> list[ChainDrive]:
    """Return the recordings as drives for the naming, with the charge that the model sees.

    Effects are named on the chain, whatever the model is: a network's errors on new drives
    differ from those on its training drives, and look like an effect. Effects that
    the model has already move the chain as well.

    healthy : what is known of the vehicle comes from these; of a model that was fitted to others
        the charge is as broadcast, because its error there may hold part of what is looked for
    Raises RecordingError if a recording lacks a signal or too little of it can be scored.
    """
    card = check(model)
    made = plain_drives_of(card, recordings, healthy)
    if not card.effects:
        return made
    if card.kind == GREYBOX:
        alone, read = replace(Greybox.of(card), effects=()), predicted_phi(model, recordings)
        seen = plain_drives_of(card, recordings)
        return [
            replace(drive, moved_phi=phi - simulate(alone.path(own.signals), own.period_s))
            for drive, own, phi in zip(made, seen, read, strict=True)
        ]
    added = ChainDifference.from_card(card)
    return [replace(d, moved_phi=added.values(d.signals)) for d in made]


def plain_drives_of(
    card: ModelCard, recordings: Sequence[Recording], healthy: Sequence[Recording] = ()
) -> list[ChainDrive]:
    """Return the recordings as drives, without the effects that the model has.

    healthy : as in ``drives_of``
    Raises RecordingError as ``drives_of``.
    """
    if card.kind != GREYBOX:
        return [from_recording(each) for each in recordings]
    chain = Greybox.of(card)
    meter_s = chain.charge.time_s if isinstance(chain.charge, ChargeError) else None
    trained, given = ({each.sha256 for each in of} for of in (card.recordings, healthy))
    if meter_s and given and not trained <= given:  # it was fitted to others, too
        chain, meter_s = replace(chain, charge=None), None
    own = tuple(seeing(each, chain.inputs, chain.limits) for each in chain.own)
    return [
        replace(from_recording(each, made), charged=bool(made), meter_s=meter_s, own=own)
        for each, made in ((each, _made(each, chain)) for each in recordings)
    ]


def _made(recording: Recording, chain: Greybox) -> dict[str, FloatArray]:
    """Return the signals (n,) that the model makes for itself: the charge, and with it speed.

    NaN where one of those that it makes them of was not measured.
    """
    if chain.charge is None:
        return {}
    inputs = {name: recording.column(name) for name in chain.inputs}
    measured = np.isfinite([*inputs.values()]).all(axis=0)
    signals = chain.seen({name: hold(values) for name, values in inputs.items()})
    wanted = ["air_mass_mg", *({"engine_speed_rpm"} - set(chain.inputs))]
    return {name: np.where(measured, signals[name], np.nan) for name in wanted}
