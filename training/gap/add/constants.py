"""Constants of what was named, from the recordings that are not held out.

Beside a network there may be two answers: constants that suit the chain, on which effects are
named, and those that suit the errors that the network makes beyond those it makes on healthy
drives, because it reads an effect in its own way. Which of them predict better is tried.
"""

from collections.abc import Sequence
from dataclasses import replace

from training.chain import Constants
from training.gap import base
from training.gap.add.across_drives import fit_alike, holds_on_others
from training.gap.add.added import Added
from training.gap.drives import Drive
from training.gap.given import Given, split
from training.gap.name.begin import begin
from training.gap.name.fitting import fit
from training.gap.name.verdict import Naming
from training.gap.reference import healthy
from training.gap.reference.healthy import Healthy


def refitted(
    given: Given, naming: Naming, known: Healthy | None, start: Constants
) -> list[tuple[Added, ...]]:
    """Return what was named, with each of its possible constants, those of the chain first.

    Constants that, fitted to some of the recordings, predict the others no better than none are
    left out. A grey-box model takes over the base of the naming. Beside a network there is the
    plain chain; where healthy recordings tell which errors the network makes anyway, constants
    that suit its other errors come second.
    """
    recordings = [given.recordings[i] for i in split(given)[0]]
    drives = base.drives_of(given.model, recordings, given.healthy)
    found = [_fitted(drives, naming, known, start)]
    if known and given.healthy and base.check(given.model).kind != base.GREYBOX:
        alone = replace(known, base=known.plain, own=(), charge=None)
        known = healthy.learn(base.read_by(given.model, given.healthy), known.plain, alone)
        found.append(_fitted(base.read_by(given.model, recordings), naming, known, start))
    return [each for each in found if each]


def _fitted(
    drives: Sequence[Drive], naming: Naming, known: Healthy | None, start: Constants
) -> tuple[Added, ...]:
    """Return what was named with constants of these drives, nothing if they do not hold."""
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
