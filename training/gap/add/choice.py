"""The new model's file: named effects in the form and with the constants that predict best."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from monitor.base import config
from monitor.base.errors import ModelError, RecordingError, UsageError
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.gap.add import greybox, network
from training.gap.add.network_parity import ParityError
from training.gap.config import CONFIG
from training.gap.inputs.roles import ACCEPTED, GapOptions, Material
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive
from training.greybox.graph.chain_graph import Greybox
from training.greybox.graph.effect_inputs import Ranges
from training.healthy import base
from training.healthy.behaviour import Healthy
from training.jobs import Progress
from training.limits.decision_limits import whole, with_limits
from training.limits.judging import judge_recordings
from training.narx.export import update_card
from training.narx.model_file import HeldOut
from training.recordings.prediction import predicted_phi
from training.recordings.recording import Recording, training_recording

FORMS: Final = {
    "greybox": "inside the chain, where it acts on the mixture's way",
    "output": "beside the network: its output plus the chain with the effect less that without",
    "input": "as one more input of the network, trained anew",
}
TRAINED_ANEW: Final = "input"
AGAINST: Final = {"output": "beside its output", "input": "trained anew"}
HELD_OUT_BLOCKS: Final = "blocks of the recordings of the fit held out of the training anew"


def add(
    material: Material,
    out: Path,
    choices: Sequence[Sequence[ModelEffect]],
    known: Healthy | None,
    start: Constants,
    options: GapOptions,
    progress: Progress = lambda _: None,
) -> tuple[Path | None, str, tuple[ModelEffect, ...]]:
    """Write the new model that predicts best to ``out``; return it, its form and its effects.

    choices : the effects, once for every set of constants, the preferred set first
    Returns None and no file if the new model predicts no better than the old one. They are held
    against each other on the recordings of the fit; if either was trained on some of these, on the
    recordings held out. Decision limits are set anew, because the old ones belong to the old
    model's errors; ``_set_limits`` may keep them.
    Raises ParityError if no form computes the same in ONNX and numpy, ModelError as
    ``network.add``.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    own = _Forms.of(material, known.plain if known else start)
    if own.card.kind == base.GREYBOX:
        best, says = own.inside_chain(choices, known, out), FORMS[base.GREYBOX]
    else:
        with TemporaryDirectory(dir=out.parent) as folder:
            best, says = _best(own.beside_network(choices, Path(folder)))
            if options.retrain_minutes > 0.0:
                best, says = own.or_trained_anew(best, says, options.retrain_minutes, progress)
            best.path.replace(out)
    judges = own.unseen if best.form == TRAINED_ANEW else own.judges
    if not best.rmse < _rmse(material.model, judges):
        out.unlink()
        return None, "", ()
    origin = HELD_OUT_BLOCKS if best.form == TRAINED_ANEW else ACCEPTED
    _set_limits(out, own.fit, best.blocks, origin)
    return out, says, best.added


@dataclass(frozen=True, slots=True)
class _Tried:
    """A file with effects in one form, and its error."""

    form: str
    added: tuple[ModelEffect, ...]
    path: Path
    rmse: float  # phi
    blocks: Sequence[HeldOut]  # of the recordings of the fit, to set its limits on


@dataclass(frozen=True, slots=True, kw_only=True)
class _Forms:
    """The old model, the recordings by their use, and the forms that effects can be added in."""

    model: Path
    card: ModelCard
    healthy: Sequence[Recording]
    chain: Constants  # in which the effects stand beside a network
    fit: list[Recording]  # constants and networks are fitted to them
    unseen: list[Recording]  # no fit saw them, if there are such, not even the old model's
    known: bool  # the old model was trained on some of ``fit``
    drives: Sequence[ChainDrive]  # of ``fit``
    ranges: Ranges  # low and high of the signals that all of ``fit`` have

    @classmethod
    def of(cls, material: Material, chain: Constants) -> "_Forms":
        card, fit, held_out = base.check(material.model), material.fit, material.held_out
        trained_on = {each.sha256 for each in card.recordings}
        drives = base.drives_of(material.model, fit, material.healthy)
        return cls(
            model=material.model,
            card=card,
            healthy=material.healthy,
            chain=chain,
            fit=fit,
            unseen=[each for each in held_out if each.sha256 not in trained_on] or held_out,
            known=any(each.sha256 in trained_on for each in fit),
            drives=drives,
            ranges=_ranges(fit, drives),
        )

    @property
    def judges(self) -> list[Recording]:
        """Return the recordings on which the old model is held against one not trained anew."""
        return self.unseen if self.known and self.unseen else self.fit

    def inside_chain(
        self, choices: Sequence[Sequence[ModelEffect]], known: Healthy | None, out: Path
    ) -> _Tried:
        """Write the chain with the effects in it; there is one set of constants."""
        (added,) = map(tuple, choices)
        vehicle = (
            greybox.ChainVehicle.of(known, Greybox.of(self.card), self.drives) if known else None
        )
        greybox.add(
            self.model,
            added,
            out,
            ranges=self.ranges,
            recordings=tuple(map(training_recording, self.fit)),
            vehicle=vehicle,
        )
        return self._tried(base.GREYBOX, added, out, whole(self.fit))

    def beside_network(
        self, choices: Sequence[Sequence[ModelEffect]], folder: Path
    ) -> list[_Tried]:
        """Write the network with effects at its output, with each of the choices.

        Raises ParityError if none computes the same in ONNX and numpy.
        """
        # On drives that it knows a network errs less than on others: the old limits stay.
        blocks = [] if self.known else whole(self.fit)
        tried, wrong = list[_Tried](), None
        for i, added in enumerate(choices):
            path = folder / f"{i}.onnx"
            try:
                network.add(
                    self.model,
                    added,
                    self.chain,
                    path,
                    ranges=self.ranges,
                    recordings=tuple(map(training_recording, self.fit)),
                    drives=self.drives,
                )
            except ParityError as error:
                wrong = error
            else:
                tried.append(self._tried("output", tuple(added), path, blocks))
        if wrong is not None and not tried:
            raise wrong
        return tried

    def or_trained_anew(
        self, other: _Tried, says: str, budget_minutes: float, progress: Progress
    ) -> tuple[_Tried, str]:
        """Return the better of a file and a network trained anew beside it, in words."""
        if not self.unseen:
            return other, f"{says}; not trained anew: no recording is held out to judge it on"
        path = other.path.with_name("retrained.onnx")
        try:
            blocks = network.retrain(
                self.model,
                other.added,
                self.chain,
                self.fit,
                path,
                ranges=self.ranges,
                healthy=self.healthy,
                budget_minutes=budget_minutes,
                progress=progress,
            )
        except (ModelError, RecordingError, UsageError) as error:
            return other, f"{says}; not trained anew: {error}"
        rmse = _rmse(path, self.unseen)
        anew = replace(other, form=TRAINED_ANEW, path=path, rmse=rmse, blocks=blocks)
        best, says = _best([replace(other, rmse=_rmse(other.path, self.unseen)), anew])
        return (best if best is anew else other), says

    def _tried(
        self, form: str, added: tuple[ModelEffect, ...], path: Path, blocks: Sequence[HeldOut]
    ) -> _Tried:
        return _Tried(form, added, path, _rmse(path, self.judges), blocks)


def _ranges(recordings: Sequence[Recording], drives: Sequence[ChainDrive]) -> Ranges:
    """Return low and high of the signals that all of the recordings have."""
    return {
        name: (
            float(min(np.min(d.signals[name]) for d in drives)),
            float(max(np.max(d.signals[name]) for d in drives)),
        )
        for name in drives[0].signals
        if all(name in d.signals for d in drives)
        and all(name in recording.known for recording in recordings)  # not worked out
    }


def _best(tried: Sequence[_Tried]) -> tuple[_Tried, str]:
    """Return the first file about as good as the best, and its form in words."""
    least = min(each.rmse for each in tried)
    best = next((each for each in tried if each.rmse <= CONFIG.add.as_good * least), tried[0])
    rivals = [each for each in tried if each.form != best.form]
    if not rivals:
        return best, FORMS[best.form]
    rival = min(rivals, key=lambda each: each.rmse)
    against = f"RMSE {best.rmse:.4f} against {rival.rmse:.4f} {AGAINST[rival.form]}"
    return best, f"{FORMS[best.form]} ({against})"


def _set_limits(
    new: Path, recordings: Sequence[Recording], blocks: Sequence[HeldOut], origin: str
) -> None:
    """Set the limits of the new model on blocks, unless those it has let it see more.

    A model without limits keeps none, and too few windows change nothing. The old limits stay
    where they give evidence more weight and no code stands on the recordings with them.
    """
    settings, model = config.load(), Model.load(new)
    if not model.card.limits:
        return
    try:
        card, _ = with_limits(model, recordings, blocks, settings, origin)
    except RecordingError:
        return
    found, old = (Limits.from_card(each, settings, str(new)) for each in (card, model.card))
    if old.evidence > found.evidence:
        judged = judge_recordings(recordings, model, old, settings)
        if not any(each.dtcs for each in judged):
            return
    update_card(new, card)


def _rmse(model: Path, recordings: Sequence[Recording]) -> float:
    """Return the RMSE in phi on the scored samples of recordings."""
    drives = base.plain_drives_of(base.check(model), recordings)
    runs = predicted_phi(model, recordings)
    squares = [(p - d.phi_measured)[d.scored] ** 2 for d, p in zip(drives, runs, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))
