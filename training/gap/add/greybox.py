"""Effects become part of a grey-box model's file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from monitor.base.errors import ModelError
from monitor.model.card import ModelCard, TrainingRecording
from monitor.model.step import Model
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.constants import Fitted, described, reference
from training.greybox.graph.chain_graph import Greybox, build
from training.greybox.graph.effect_inputs import SPEED, Ranges, channel_of, limits_of, seeing
from training.narx.export import write

BEFORE = "before_effects"  # what the card's measures are of: the new model's are not known here
BEFORE_EFFECTS = "; of the base before effects were added, with other values"


def add(
    model: Path | str,
    added: Sequence[ModelEffect],
    out: Path | str,
    *,
    ranges: Ranges,
    recordings: Sequence[TrainingRecording],
    vehicle: Greybox | None = None,
) -> ModelCard:
    """Write ``model`` with effects behind those it has already to ``out``; return its card.

    ranges : low and high of every signal present in the drives of the fit; an optional signal
        that is not among them was not there, and the effect takes its own default for it
    recordings : what the effects were fitted to
    vehicle : chain with which the effects were fitted, if its constants are not the model's
    Raises ModelError if the model is not a grey-box or a signal is missing.
    """
    card = Model.load(model).card
    if card.kind != "greybox":
        raise ModelError(f"{model}: a {card.kind} model, a greybox is wanted to add effects in it")
    old = vehicle or Greybox.of(card)
    added = [seeing(each, old.inputs, ranges) for each in added]
    greybox = _extended(old, added, ranges)
    known = {channel.name: channel for channel in card.inputs}
    by_sha = {r.sha256: r for r in (*card.recordings, *recordings)}
    card = replace(
        card,
        inputs=tuple(channel_of(n, known.get(n), ranges.get(n)) for n in greybox.inputs),
        lags=greybox.memory,
        state=greybox.state_layout,
        recordings=tuple(by_sha.values()),
        effects=(*card.effects, *(each.to_card(recordings) for each in added)),
        structure=dict(card.structure) | greybox.structure(),
        fit={BEFORE: card.fit.get(BEFORE, card.fit)},
        checks={},
    )
    if vehicle is not None:
        card = _with_constants(card, vehicle.constants)
    write(out, build(greybox), card)
    return card


def _extended(old: Greybox, added: Sequence[ModelEffect], ranges: Ranges) -> Greybox:
    own = [seeing(each, old.inputs, ranges) for each in old.own]
    wanted = dict.fromkeys(name for each in (*own, *added) for name in each.reads or ())
    further = [name for name in wanted if name not in (*old.inputs, SPEED)]  # it knows the speed
    limits = limits_of((*old.inputs, *further), old.limits, ranges)
    return replace(old, limits=limits, effects=(*old.effects, *added))


def _with_constants(card: ModelCard, constants: Constants) -> ModelCard:
    """Return the card with other constants; their errors stay those of the old fit."""
    given = card.structure
    fitted = Fitted(
        constants=constants,
        covariance=np.array(given["covariance"]),
        noise_model=tuple(given["noise_model"]),
        rmse=given["rmse_phi"],
        white_rmse=given["white_rmse_phi"],
        samples=given["samples"],
        spread=given["starts_rmse_spread"],
        at_bound=tuple(given["at_bound"]),
    )
    note = {"standard_errors": str(given["standard_errors"]).removesuffix(BEFORE_EFFECTS)}
    note["standard_errors"] += BEFORE_EFFECTS
    return replace(
        card,
        structure=dict(given) | described(fitted) | note,
        reference=dict(card.reference) | reference(fitted) | note,
    )
