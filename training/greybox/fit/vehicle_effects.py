"""Effects that some healthy vehicles have so strongly that the base needs them.

With port injection much of the fuel passes over the walls, and an ECU that compensates for them
commands a fuel mass that the mixture does not follow. A chain without walls then follows poorly,
and its fitted lags and charge imitate the walls.
"""

from typing import Final

import numpy as np

from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.model_effect import Effects
from training.greybox.fit.case import WHITE, Case, has_its_signs
from training.greybox.fit.drive import ChainDrive
from training.greybox.fit.joint import JointFit, fit

OF_SOME: Final = ("wall_film", "manifold_filling")
FALL: Final = 0.3  # relative fall of the squared error with which the first effect is accepted
FURTHER_FALL: Final = 0.1  # and the second: without it, walls would stand for both


def own_of(drive: ChainDrive) -> Effects:
    """Return the effects of a healthy vehicle with their values, none if it has no strong one."""
    case = Case((drive,), (np.zeros(len(drive)),), WHITE)
    return with_more(case, fit(case, (), [Constants()]))[1].effects


def with_more(case: Case, found: JointFit) -> tuple[list[Effect], JointFit]:
    """Return the effects that drives show beyond a plain fit, strongest first, and their fit."""
    effects, fall = list[Effect](), FALL
    left = [LIBRARY[name] for name in OF_SOME]
    left = [e for e in left if all(set(e.needs) <= set(d.signals) for d in case.drives)]
    while left:
        fits = {effect.name: fit(case, (*effects, effect), [found]) for effect in left}
        best = min(left, key=lambda effect: fits[effect.name].cost)
        more = fits[best.name]
        if more.cost > (1.0 - fall) * found.cost or not has_its_signs(best, more.parameters[-1]):
            break
        left.remove(best)
        fall = FURTHER_FALL
        effects, found = [*effects, best], more
    return effects, found
