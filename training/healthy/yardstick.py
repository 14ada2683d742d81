"""The yardstick of every score: differences between the vehicle's healthy drives.

Healthy drives are left out in turn and judged by what the others say. A candidate should gain on
them what noise gives it, one unit of the likelihood ratio for each of its constants. Where healthy
drives give it more (weather, fuel and operating points move the vehicle in the candidate's own
direction), its score on new drives must be larger by as much.
Source: Wedderburn, Quasi-likelihood functions, Biometrika 61 (1974), whose dispersion this is.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from training.greybox.chain import Constants
from training.greybox.fit.case import Term
from training.greybox.fit.drive import ChainDrive, phi_of
from training.greybox.fit.joint import fit, held_out_rmse
from training.greybox.fit.sensor_faults import FAULTS
from training.healthy import behaviour
from training.healthy.base_state import BaseState, base_state
from training.healthy.behaviour import CONSTANT, Healthy
from training.jobs import Progress

GROUPS_MOST: Final = 6  # of drives that are left out together
GROUPS_LEAST: Final = 3  # fewer say nothing of how drives differ
PRIOR_GROUPS: Final = 2.0  # groups that count as having given what noise gives


def learn(
    drives: Sequence[ChainDrive], start: Constants, progress: Progress = lambda _: None
) -> Healthy:
    """Return the healthy behaviour in ``drives``, with the differences between them."""
    drives = behaviour.as_shown(drives, start)
    known = behaviour.learn(drives, start)
    if (groups := min(len(drives), GROUPS_MOST)) < GROUPS_LEAST:  # a mean of few is uncertain
        return replace(known, spread=known.spread * np.sqrt(1.0 + 1.0 / len(drives)))
    held_out = []
    for k in range(groups):
        progress(f"healthy drives without group {k + 1} of {groups}")
        rest = [d for i, d in enumerate(drives) if i % groups != k]
        held_out.append((drives[k::groups], behaviour.learn(rest, start, known)))
    known = replace(known, doubt=known.doubt[:, :0])
    known = _with_offsets(known, [m for own, others in held_out for m in _offsets(own, others)])
    states, spread = [], dict(zip(known.names, known.spread.tolist(), strict=True))
    for own, others in held_out:
        with suppress(RecordingError):  # of driving that the others do not know
            own_spread = np.array([spread.get(name, 0.0) for name in others.names])
            alike = replace(others, spread=own_spread, doubt=others.doubt[:, :0])
            states.append(base_state(own, alike, alike.base))
    left = [_left_out(state) for state in states]
    names = set[str]().union(*left)
    surplus = {name: _typical([ratio[name] for ratio in left if name in ratio]) for name in names}
    rmse = [held_out_rmse(state.case, state.current) for state in states]
    return replace(known, surplus=surplus, rmse_usual=float(np.median(rmse)) if rmse else None)


def _offsets(drives: Sequence[ChainDrive], known: Healthy) -> list[float]:
    """Return the mean error of every drive by the healthy behaviour of the other drives, in phi."""
    offsets = []
    for drive in map(known.known_of, drives):
        rows = drive.kept
        own = phi_of(drive, known.base)
        error = own + known.correction(drive) - drive.phi_measured
        offsets += [float(error[rows].mean())] if rows.any() else []
    return offsets


def _with_offsets(known: Healthy, offsets: Sequence[float]) -> Healthy:
    """Return the healthy behaviour with the spread of the drives' offsets."""
    if CONSTANT not in known.names or len(offsets) < GROUPS_LEAST:
        return known
    spread = known.spread.copy()
    at = known.names.index(CONSTANT)
    spread[at] = max(spread[at], float(np.sqrt(np.mean(np.square(offsets)))))
    return replace(known, spread=spread)


def _typical(ratios: Sequence[float]) -> float:
    """Return the geometric mean of ratios, none below 1: a single drive of another kind weighs
    little.
    """
    logarithms = np.log(np.maximum(ratios, 1.0))
    return float(np.exp(logarithms.sum() / (len(ratios) + PRIOR_GROUPS)))


def _left_out(state: BaseState) -> dict[str, float]:
    """Return the likelihood ratio of every candidate per constant."""
    drives = state.case.drives
    terms: tuple[Term, ...] = (*drives[0].effects, *FAULTS)
    ratio = {}
    for term in terms:
        if any(not set(getattr(term, "needs", ())) <= set(d.signals) for d in drives):
            continue
        fitted = fit(state.case, (term,), [state.current])
        gain = 2.0 * (state.current.cost - fitted.cost)
        ratio[term.name] = max(gain, 0.0) / len(term.parameters)
    return ratio
