"""An effect that no library has, as a formula of recorded signals: searched for, scored, added.

Each form of the signals that may explain most is fitted and scored on held-out blocks as the
library's effects are; the best is kept, and a further one on top of it as long as it gains clearly.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from training.gap.name import scoring
from training.gap.name.ranking import State, rank
from training.gap.name.signal_functions import columns, functions_of
from training.gap.name.verdict import Candidate
from training.greybox.effects import Effect
from training.greybox.effects.empirical import FORMS, effect_of, name_of
from training.jobs.checkpoints import Progress

TERMS_MOST: Final = 2
SIGNALS_MOST: Final = 3  # whose forms are fitted
GAIN_LEAST: Final = 400.0  # of the held-out deviance, as for a plain function to be clear
T_LEAST: Final = 4.0
SHARE_LEAST: Final = 0.1  # of the first term's gain
NEARLY: Final = 0.95  # of the best gain, from which a form of fewer constants goes first
RANGE: Final = (0.02, 0.98)  # quantiles that a curve spans


def formula_of(state: State, progress: Progress = lambda _: None) -> tuple[Candidate, ...]:
    """Return the terms of the formula, none if nothing is clear."""
    terms, found = _forms(state), list[Candidate]()
    while terms and len(found) < TERMS_MOST:
        progress("formula")
        ranking = rank(state, terms, lambda _: None)
        least = max(GAIN_LEAST, SHARE_LEAST * (found[0].merit.score if found else 0.0))
        nearly = max(least, NEARLY * ranking[0].merit.score)
        good = [c for c in ranking if c.merit.score >= nearly and c.merit.t >= T_LEAST]
        if not good:
            break
        best = min(good, key=lambda c: (len(c.term.parameters), -c.merit.score))
        found.append(best)
        signal = best.name.split(":")[1]
        terms = [t for t in terms if t.name.split(":")[1] != signal]
        deviance = scoring.deviance(best.fit, state.case.blocks)
        state = replace(state, current=best.fit, deviance=deviance)
    return tuple(found)


def _forms(state: State) -> list[Effect]:
    """Return every form of the signals that may explain most, by least squares over all blocks."""
    drives = state.case.drives
    functions = functions_of(drives)
    if not functions:
        return []
    made = [columns(drive, state.current.base, functions) for drive in drives]
    table = scoring.ceiling(state.case, made).columns
    target = np.clip(-state.current.residual, -scoring.LARGEST, scoring.LARGEST)
    explained = {}
    for signal in dict.fromkeys(f.signal for f in functions):
        own = table[:, [f.signal == signal for f in functions]]
        explained[signal] = float(((own @ np.linalg.lstsq(own, target)[0]) ** 2).sum())
    found = []
    for signal in sorted(explained, key=lambda s: -explained[s])[:SIGNALS_MOST]:
        x = np.concatenate([drive.signals[signal][drive.kept] for drive in drives])
        low, high = np.quantile(x, RANGE).tolist()
        if high > low:
            middle, half = (low + high) / 2.0, (high - low) / 2.0
            found += [effect_of(name_of(signal, form, middle, half)) for form in FORMS]
    return found
