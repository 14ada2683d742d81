"""How much of a gap plain functions of one signal explain: all forms of it at once, and quickly."""

from collections.abc import Collection
from typing import Final

from monitor.base.types import FloatArray
from training.gap.name.formulas.signal_functions import columns, functions_of
from training.greybox.fit import ridge
from training.greybox.fit.drive import FOLDS
from training.healthy import scoring
from training.healthy.base_state import BaseState

NO_CAUSES: Final = ("sensor_heater_percent",)  # answers the exhaust's flow and temperature


def left_by_signal(state: BaseState, without: Collection[str] = ()) -> dict[str, FloatArray]:
    """Return the held-out deviance of every block, (n_blocks,), that each signal leaves.

    Signals come in the order of what they explain; those of ``without`` are left out.
    """
    drives, blocks = state.case.drives, state.case.blocks
    functions = [f for f in functions_of(drives) if f.signal not in (*without, *NO_CAUSES)]
    made = [columns(drive, state.current.base, functions) for drive in drives]
    table, error = scoring.ceiling(state.case, made), state.current.residual
    left = {}
    for signal in dict.fromkeys(f.signal for f in functions):
        own = table[:, [f.signal == signal for f in functions]]
        rest = error - ridge.fit(own, error, blocks % FOLDS).held_out
        left[signal] = scoring.by_block(rest, blocks)
    return dict(sorted(left.items(), key=lambda item: item[1].sum()))


def left_by_best_signal(state: BaseState) -> FloatArray:
    """Return the least that a signal leaves, (n_blocks,); the whole deviance if no signal moves."""
    return next(iter(left_by_signal(state).values()), state.deviance)
