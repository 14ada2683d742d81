"""What was named becomes part of the model: constants, the form that predicts best, the file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from monitor import config
from monitor.errors import RecordingError
from monitor.limits import Limits
from monitor.model import Model
from monitor.model_card import TrainingRecording
from training.chain import Constants
from training.export import update_card
from training.gap import base
from training.gap.add import add_greybox, add_narx
from training.gap.add.across_drives import fit_alike, holds_on_others
from training.gap.add.add_narx_network import BEFORE, TO_OUTPUT
from training.gap.add.added import Added
from training.gap.add.effect_inputs import Ranges
from training.gap.add.effect_parity import ParityError
from training.gap.check.detection import ACCEPTED
from training.gap.drives import Drive
from training.gap.given import Given, Options, split
from training.gap.name.begin import begin
from training.gap.name.fitting import fit
from training.gap.name.verdict import Naming
from training.gap.predicted import predicted_phi
from training.gap.reference import healthy
from training.gap.reference.healthy import Healthy
from training.gap.result import of_recording
from training.greybox_graph import Greybox
from training.judge import judge_recordings
from training.limits import whole, with_limits
from training.recordings import Recording

FORMS: Final = {
    "greybox": "inside the chain, where it acts on the mixture's way",
    "before": "before the network, which reads fuel and lambda controller as if it were not there",
    "output": "beside the network: its output plus the chain with the effect less that without",
    "input": "as one more input of the network, trained anew",
}
AGAINST: Final = {"before": "before it", "output": "beside its output", "input": "trained anew"}
WORSE: Final = 1.02  # of the RMSE, up to which a form counts as no worse


def refitted(
    given: Given, naming: Naming, known: Healthy | None, start: Constants
) -> tuple[Added, ...]:
    """Return what was named, with constants from the recordings that are not held out.

    Nothing if constants from some of these recordings predict the others no better than none.

    A grey-box model takes over the base of the naming. Beside a network there is the plain chain;
    the network's own errors are what the constants have to suit there, where healthy recordings
    tell which of them it makes anyway.
    """
    recordings = [given.recordings[i] for i in split(given)[0]]
    greybox = base.check(given.model).kind == base.GREYBOX
    drives = base.drives_of(given.model, recordings, given.healthy)
    if known and given.healthy and not greybox:
        alone = replace(known, base=known.plain, own=(), charge=None)
        known = healthy.learn(base.read_by(given.model, given.healthy), known.plain, alone)
        drives = base.read_by(given.model, recordings)
    state = begin(drives, known, known.base if known else start)
    last = naming.effects[-1].fit
    case, again = fit_alike(state.case, fit(state.case, last.terms, [last]))
    if not holds_on_others(case, state.current, again):
        return ()
    added = []
    for candidate, values, errors in zip(
        naming.effects, again.parameters, again.standard_errors, strict=True
    ):
        names = list(candidate.parameters)
        added.append(
            Added.of(
                replace(
                    candidate,
                    parameters=dict(zip(names, values.tolist(), strict=True)),
                    standard_errors=dict(zip(names, errors.tolist(), strict=True)),
                )
            )
        )
    return tuple(added)


def add(
    given: Given, out: Path, added: Sequence[Added], known: Healthy | None, start: Constants,
    options: Options,
) -> tuple[Path | None, str]:  # fmt: skip
    """Write the new model in the form that predicts best; return it and the form.

    There is none if it predicts the recordings of the fit no better than the old one. Its decision
    limits are set on them: those of the old model go with the old model's errors.
    Raises ParityError if no form computes the same in ONNX and numpy.
    """
    card = base.check(given.model)
    out.parent.mkdir(parents=True, exist_ok=True)
    recordings = [given.recordings[i] for i in split(given)[0]]
    drives = base.drives_of(given.model, recordings, given.healthy)
    ranges = {
        name: (
            float(min(np.min(d.signals[name]) for d in drives)),
            float(max(np.max(d.signals[name]) for d in drives)),
        )
        for name in drives[0].signals
        if all(name in d.signals for d in drives)
        and all(name in recording.known for recording in recordings)  # not worked out
    }
    used = tuple(map(of_recording, recordings))
    if card.kind == base.GREYBOX:
        vehicle = add_greybox.Vehicle.of(known, Greybox.of(card), drives) if known else None
        add_greybox.add(
            given.model, added, out, ranges=ranges, recordings=used, vehicle=vehicle, drives=drives
        )
        return _if_better(given.model, out, recordings, FORMS["greybox"])
    reference = known.plain if known else start
    form, says = _beside_network(given, out, added, reference, ranges, used, drives)
    if options.retrain_minutes <= 0.0:
        return _if_better(given.model, out, recordings, says)
    other = out.with_name("retrained.onnx")
    try:
        add_narx.retrain(
            given.model, added, reference, recordings, other, ranges=ranges,
            budget_minutes=options.retrain_minutes,
        )  # fmt: skip
    except ParityError:
        return _if_better(given.model, out, recordings, says)
    kept, says = _kept(out, other, form, "input", split(given)[1] or recordings)
    # Trained on the recordings it errs less on them than on others: the old limits stay.
    return _if_better(given.model, out, recordings, says, limits=kept == form)


def _beside_network(
    given: Given, out: Path, added: Sequence[Added], chain: Constants, ranges: Ranges,
    used: Sequence[TrainingRecording], drives: Sequence[Drive],
) -> tuple[str, str]:  # fmt: skip
    """Write the network with effects before it or at its output; return the form, also in words."""
    forms = {"output": TO_OUTPUT}
    if add_narx.can_stand_before(given.model, added, chain, drives[0]):
        forms = {"before": BEFORE, **forms}
    written, wrong = {}, None
    for name, form in forms.items():
        path = out.with_name(f"{name}.onnx")
        try:
            add_narx.add(
                given.model, added, chain, path, ranges=ranges, recordings=used, drives=drives,
                form=form,
            )  # fmt: skip
            written[name] = path
        except ParityError as error:
            wrong = error
    if not written:
        assert wrong is not None
        raise wrong
    first, *others = written
    written[first].replace(out)
    if not others:
        return first, FORMS[first]
    recordings = [given.recordings[i] for i in split(given)[0]]
    return _kept(out, written[others[0]], first, others[0], recordings)


def _kept(
    out: Path, other: Path, form: str, of_other: str, recordings: Sequence[Recording]
) -> tuple[str, str]:
    """Leave the better of two files in ``out``; return its form, and it in words."""
    own, others = (_rmse(each, recordings) for each in (out, other))
    if others * WORSE < own:
        other.replace(out)
        return of_other, f"{FORMS[of_other]} (RMSE {others:.4f} against {own:.4f} {AGAINST[form]})"
    other.unlink()
    return form, f"{FORMS[form]} (RMSE {own:.4f} against {others:.4f} {AGAINST[of_other]})"


def _if_better(
    old: Path, new: Path, recordings: Sequence[Recording], form: str, *, limits: bool = True
) -> tuple[Path | None, str]:
    if _rmse(new, recordings) >= _rmse(old, recordings):
        new.unlink()
        return None, ""
    if limits and Model.load(old).card.limits:
        _set_limits(new, recordings)
    return new, form


def _set_limits(new: Path, recordings: Sequence[Recording]) -> None:
    """Set the limits of the new model on recordings, unless those that it has let it see more.

    A window may be judged from some movement on; the old limits stay where they want less of it
    and no code stands on the recordings with them.
    """
    settings, model = config.load(), Model.load(new)
    try:
        card, _ = with_limits(model, recordings, whole(recordings), settings, ACCEPTED)
    except RecordingError:  # too few windows
        return
    found, old = (Limits.from_card(each, settings, str(new)) for each in (card, model.card))
    if old.excitation < found.excitation:
        judged = judge_recordings(recordings, model, old, settings)
        if not any(each.dtcs for each in judged):
            return
    update_card(new, card)


def _rmse(model: Path, recordings: Sequence[Recording]) -> float:
    """Return the RMSE in phi on the scored samples of recordings."""
    squares = []
    for recording, phi in zip(recordings, predicted_phi(model, recordings), strict=True):
        (drive,) = base.drives_of(model, [recording])
        squares.append((phi - drive.phi_measured)[drive.scored] ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))
