"""The base models of a study: fitted to a vehicle's recordings, as ``o2train fit`` does."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from monitor import config
from monitor.errors import RecordingError
from monitor.model import Model
from monitor.signals import NARX_INPUTS, OUTPUT
from training import fit
from training.chain import Constants
from training.gap import drives
from training.gap.drives import Drive
from training.gap.predicted import predicted_phi
from training.greybox_graph import Greybox
from training.greybox_model import fit_greybox
from training.limits import set_limits
from training.recordings import Recording

GREYBOX: Final = "greybox"
NARX: Final = "narx"
BUDGET_MINUTES: Final = 3.0  # of a training on two hours; it ends by itself in half a minute
LAGS: Final = 5
HIDDEN: Final = (8, 8)


def fit_base(base: str, recordings: Sequence[Recording], out: Path) -> None:
    """Fit a model of the kind ``base`` and write it to ``out``, with limits if they can be set."""
    if base == GREYBOX:
        held_out = fit_greybox(recordings, out).held_out
    else:
        held_out = fit.fit(
            recordings, NARX_INPUTS, OUTPUT, out, lags=LAGS, hidden=HIDDEN, input_lag_start=0,
            starts=1, budget_minutes=BUDGET_MINUTES, threads=1,
        ).held_out  # fmt: skip
    with suppress(RecordingError):  # too few windows: the model stands without limits
        set_limits(out, recordings, held_out, config.load())


def constants_of(model: Path) -> Constants:
    """Return a grey-box model's constants; usual ones for a network."""
    card = Model.load(model).card
    return Greybox.of(card).constants if card.kind == GREYBOX else Constants()


def drives_of(model: Path, recordings: Sequence[Recording]) -> list[Drive]:
    """Return the recordings as the naming wants them, with what a network reads."""
    made = [drives.from_recording(each) for each in recordings]
    if Model.load(model).card.kind == GREYBOX:
        return made
    run = predicted_phi(model, recordings)
    return [replace(d, phi_of_model=phi) for d, phi in zip(made, run, strict=True)]
