"""Effects become part of a network's file: added to its output, or as one more input.

The chain with the effects minus the chain without is what they change at the sensor: added to the
output it leaves the network as it is; as an input the network is trained anew and may weigh it by
regime.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import BoolArray
from monitor.model.card import Channel, ModelCard, TrainingRecording
from monitor.model.step import Model
from training.gap.add.network_graph import (
    AS_INPUT,
    DIFFERENCE,
    TO_OUTPUT,
    NetworkWithEffects,
    network_of,
)
from training.gap.add.network_parity import parity
from training.gap.add.network_training import train_again, with_difference
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive, from_recording
from training.greybox.graph.chain_difference import ChainDifference
from training.greybox.graph.effect_inputs import Ranges, channel_of
from training.jobs import Progress
from training.narx.export import Network
from training.narx.model_file import HeldOut, held_out, measures, recordings_of
from training.narx.search.stability import Contraction
from training.narx.search.stages import Trained, free_run
from training.narx.work import Work
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, prepare


def add(
    model: Path | str,
    added: Sequence[ModelEffect],
    chain: Constants,
    out: Path | str,
    *,
    ranges: Ranges,
    recordings: Sequence[TrainingRecording],
    drives: Sequence[ChainDrive],
) -> ModelCard:
    """Write ``model`` with effects beside its output to ``out``; return its card.

    chain : constants of the chain that the effects were fitted in
    ranges : low and high of every signal present in the drives of the fit; an optional signal
        that is not among them was not there, and the effect takes its own default for it
    recordings : what the effects were fitted to
    drives : on which ONNX and numpy must agree
    Effects that the model has already stay, in the chain of the new constants.
    Raises ModelError if the model is not a network, was retrained with effects, a signal is
    missing, or ONNX and numpy disagree.
    """
    network, card = network_of(model), Model.load(model).card
    _check(card, str(model))
    difference = ChainDifference.of(card, [*_older(card), *added], chain, ranges)
    inputs = tuple(dict.fromkeys((*card.input_names, *difference.inputs)))
    extended = NetworkWithEffects(TO_OUTPUT, network, difference, inputs)
    entries = _entries(card, difference, recordings)
    return save(out, extended, _card(card, extended, entries, ranges, recordings), drives)


def retrain(
    model: Path | str,
    added: Sequence[ModelEffect],
    chain: Constants,
    recordings: Sequence[Recording],
    out: Path | str,
    *,
    ranges: Ranges,
    healthy: Sequence[Recording] = (),
    budget_minutes: float = 5.0,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> tuple[HeldOut, ...]:
    """Train ``model`` again with the effects' change of phi as an input; write it to ``out``.

    added, chain, ranges : see ``add``
    recordings : to train on, with ``healthy``; blocks of both are held out to choose and to measure
    healthy : without the new effects, so that these change nothing there
    budget_minutes : of counted work, after which the best so far is kept
    progress : is told after every epoch how far it is
    Returns the blocks held out of ``recordings``; on ``healthy`` the new model is wrong, which
    takes the effects to be there.
    Decision limits and reference stay those of the old model.
    Raises ModelError as ``add``, RecordingError or UsageError if the recordings cannot be used or
    the budget is too small.
    """
    work = Work.of_minutes(budget_minutes)
    network, card = network_of(model), Model.load(model).card
    _check(card, str(model))
    older = _older(card)
    difference = ChainDifference.of(card, [*older, *added], chain, ranges)
    before = ChainDifference.of(card, older, chain, ranges)
    data = prepare(
        [with_difference(each, difference) for each in recordings]
        + [with_difference(each, before) for each in healthy],
        (*network.inputs, DIFFERENCE),
        card.output.name,
        card.transforms,
        lags=card.lags,
        seed=seed,
    )
    best, gap = train_again(data, card, network=network, seed=seed, work=work, progress=progress)
    trained = Network(
        spec=best.spec,
        weights=best.weights,
        scaling=data.scaling,
        transform=card.transform,
        transforms=card.transforms,
        inputs=data.names,
    )
    inputs = tuple(dict.fromkeys((*network.inputs, *difference.inputs)))
    extended = NetworkWithEffects(AS_INPUT, trained, difference, inputs)
    used = recordings_of(data)
    entries = _entries(card, difference, used[: len(recordings)])
    card = _card(card, extended, entries, ranges, used)
    longest = max(recordings, key=lambda each: len(each.values))
    own = np.zeros(len(data.role), dtype=bool)
    for segment in data.segments:
        own[segment.start : segment.stop] = segment.recording < len(recordings)
    card = _trained_card(card, data, own, best, gap)
    save(out, extended, card, [from_recording(longest)])
    return tuple(each for each in held_out(data) if each.recording < len(recordings))


def save(
    out: Path | str, model: NetworkWithEffects, card: ModelCard, drives: Sequence[ChainDrive]
) -> ModelCard:
    """Write the file once its parity is proved; return the card with the proof.

    Raises ParityError if ONNX and numpy disagree.
    """
    path = Path(out)
    partial = path.with_suffix(".partial")
    model.save(partial, card)
    try:
        same = parity(partial, model, drives)
    finally:
        partial.unlink()
    found = {
        "samples": same.samples,
        "onnx_numpy": same.onnx_numpy,
        "tolerance": same.tolerance,
    }
    card = replace(card, checks=dict(card.checks) | {"parity": found})
    model.save(path, card)
    return card


def _check(card: ModelCard, path: str) -> None:
    if card.transform != "phi":
        raise ModelError(f"{path}: predicts {card.output.name}, effects are added to lambda alone")


def _older(card: ModelCard) -> list[ModelEffect]:
    return (
        [entry.added for entry in ChainDifference.from_card(card).entries] if card.effects else []
    )


def _entries(
    card: ModelCard, difference: ChainDifference, recordings: Sequence[TrainingRecording]
) -> tuple[Mapping[str, Any], ...]:
    """Return the card's effects: the old ones as they stand, then the new ones."""
    return (*card.effects, *difference.effects_to_card(recordings)[len(card.effects) :])


def _card(
    card: ModelCard,
    model: NetworkWithEffects,
    entries: Sequence[Mapping[str, Any]],
    ranges: Ranges,
    recordings: Sequence[TrainingRecording],
) -> ModelCard:
    """Return the card with effects; measures, limits and reference stay those of the old model."""
    by_sha = {r.sha256: r for r in (*card.recordings, *recordings)}
    structure = {"form": model.form, "chain": model.difference.to_card()}
    return replace(
        card,
        inputs=channels(card, model.inputs, ranges),
        state=model.state_layout,
        recordings=tuple(by_sha.values()),
        effects=tuple(entries),
        structure=dict(card.structure) | structure,
    )


def channels(card: ModelCard, inputs: Sequence[str], ranges: Ranges) -> tuple[Channel, ...]:
    """Return the inputs for a card; those that the network has keep what it was trained on."""
    known = {each.name: each for each in card.inputs}
    return tuple(
        known[name] if name in known else channel_of(name, None, ranges.get(name))
        for name in inputs
    )


def _trained_card(
    card: ModelCard, data: Prepared, own: BoolArray, best: Trained, gap: Contraction
) -> ModelCard:
    """Return the card with shape and measures of the new training.

    own : (n,) samples of drives with the effects, on which the model is measured
    """
    predicted = data.scaling.unscale_y(free_run(data, best.spec, best.weights))
    test = own & (data.role == Role.TEST)
    everything, enabled = (measures(data, predicted, rows) for rows in (test, test & data.enabled))
    return replace(
        card,
        layers=best.spec.hidden,
        residual_mean=enabled.get("residual_mean", 0.0),
        residual_std=enabled.get("residual_std", everything.get("residual_std", 0.0)),
        structure=dict(card.structure) | {"members": 1},
        fit={"test": everything, "test_enabled": enabled},
        checks={"contraction": gap.to_card()},
    )
