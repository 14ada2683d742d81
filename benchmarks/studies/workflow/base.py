"""Base models of the gap study, fitted to a vehicle's recordings like ``o2train fit`` does."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from monitor.base import config
from monitor.base.errors import RecordingError
from monitor.base.signals import NARX_INPUTS, OUTPUT
from training.gap.inputs.base import GREYBOX
from training.greybox.model import fit_greybox
from training.limits.decision_limits import set_limits
from training.narx import fit
from training.recordings.recording import Recording

BUDGET_MINUTES: Final = 3.0  # upper bound; a training on two hours of driving takes half a minute
LAGS: Final = 5
HIDDEN: Final = (8, 8)


def fit_base(base: str, recordings: Sequence[Recording], out: Path) -> None:
    """Fit a model of the kind ``base`` (``greybox`` or ``narx``) and write it to ``out``.

    The model gets decision limits if the recordings hold enough windows.
    """
    if base == GREYBOX:
        held_out = fit_greybox(recordings, out).held_out
    else:
        held_out = fit.fit(
            recordings,
            NARX_INPUTS,
            OUTPUT,
            out,
            lags=LAGS,
            hidden=HIDDEN,
            input_lag_start=0,
            starts=1,
            budget_minutes=BUDGET_MINUTES,
            threads=1,
        ).held_out
    with suppress(RecordingError):  # too few windows: the model stands without limits
        set_limits(out, recordings, held_out, config.load())
