"""The base on the drives before any effect: errors whitened, healthy behaviour taken out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from training.greybox.chain import Constants
from training.greybox.fit.case import WHITE, Case, Shrink, errors, predict, shrink
from training.greybox.fit.constants import STARTS
from training.greybox.fit.drive import MIN_SCORED_S, ChainDrive
from training.greybox.fit.joint import JointFit, fit
from training.healthy import scoring
from training.healthy.behaviour import SKEW, Healthy, common, white

OVER_HEALTHY: Final = 80.0  # times what healthy drives give; see docs/how_it_works/gap.md
UNKNOWN_SURPLUS: Final = 2.0  # that healthy drives may give where none are at hand
# Constants from a card: of other drives, without what the base missed on them.
SPREAD_CARD: Final = Constants(
    gain=0.002,
    dead_time_s=0.01,
    dead_time_revolutions=0.1,
    mixing_s=0.015,
    sensor_s=0.015,
    span=0.02,
)
FREE: Final = Constants(*(10.0 * value for value in (0.1, 0.1, 1.0, 0.1, 0.1, 0.1)))
Columns = Mapping[str, FloatArray]  # of a drive, (n,) each
PHASE_MOST_S: Final = 0.02  # in the mean of all drives, of the charge's message against the fuel's
SIGMA_PHI: Final = 0.004  # of the first fit; the noise is worked out of it


@dataclass(frozen=True, slots=True)
class BaseState:
    """The start of one forward step."""

    case: Case
    current: JointFit
    roof: FloatArray  # (m, k), see ``scoring.ceiling``
    deviance: FloatArray  # (n_blocks,)
    own: FloatArray  # (n_blocks,) by how much the effects in the model have made it fall
    known: Healthy | None  # the vehicle when healthy

    def needed(self, name: str) -> float:
        """Return the score from which a candidate exceeds its score on healthy drives."""
        surplus = self.known.surplus if self.known else {}
        return OVER_HEALTHY * surplus.get(name, UNKNOWN_SURPLUS)

    def with_fit(self, found: JointFit) -> "BaseState":
        """Return the state with a fit in place of the base."""
        return replace(self, current=found, deviance=scoring.deviance(found, self.case.blocks))


def base_state(
    drives: Sequence[ChainDrive], known: Healthy | None, base: Constants | None
) -> BaseState:
    """Return the base fitted to the drives in whitened errors, and the ceiling.

    Raises RecordingError if too little lies where healthy drives have been.
    """
    if known:
        drives = _where_known(drives, known)
    # The base holds: what shifted for good is for the candidates to explain.
    prior = None if base is None else (base, SPREAD_CARD)
    starts = STARTS[:3] if base is None else (base,)  # none of a slow, weak sensor
    made = [known.columns(drive) for drive in drives] if known else []
    learned = [known.learned(own) for own in made] if known else [np.zeros(len(d)) for d in drives]
    case = Case(
        drives=tuple(drives),
        corrections=tuple(own + d.moved_phi for own, d in zip(learned, drives, strict=True)),
        ar=WHITE,
        sigma=SIGMA_PHI,
        prior=prior,
        fixed=known.base if known else None,
    )
    current = fit(case, (), starts)
    plain = common(made)[1] if made else scoring.plain_columns(case, current)
    case = scoring.whitened(case, current, plain)
    if known:
        case = replace(case, shrinks=_shrinks(case, known, made))
    current = fit(case, (), [current, *starts])
    without = fit(replace(case, corrections=tuple(learned)), (), [current])
    deviance = scoring.deviance(current, case.blocks)
    return BaseState(
        case=case,
        current=current,
        roof=scoring.ceiling(case, plain),
        deviance=deviance,
        own=scoring.deviance(without, case.blocks) - deviance,
        known=known,
    )


def _where_known(drives: Sequence[ChainDrive], known: Healthy) -> list[ChainDrive]:
    """Return the drives with enough samples where healthy drives have been, cut to these."""
    made = [known.known_of(drive) for drive in drives]
    left = [drive for drive in made if drive.kept.sum() * drive.period_s >= MIN_SCORED_S]
    if not left:
        raise RecordingError(
            f"{drives[0].name}: less than {MIN_SCORED_S:.0f} s at speeds, loads and temperatures "
            "that the healthy recordings have visited; give healthy recordings of such driving"
        )
    return left


def _shrinks(case: Case, known: Healthy, made: Sequence[Columns]) -> tuple[Shrink, ...]:
    """Return for every drive the columns that differ between healthy drives, to integrate out.

    made : all columns of each drive
    """
    columns = [
        white(known.table(own), case.ar)[rows] / case.sigma
        for own, rows in zip(made, case.rows, strict=True)
    ]
    spread = known.spread.copy()
    if SKEW in known.names:
        at = known.names.index(SKEW)
        if _is_no_phase(case, [each[:, at] for each in columns]):
            spread[at] = 0.0
    root = np.column_stack([np.diag(spread), known.doubt])
    return tuple(shrink(each @ root) for each in columns)


def _is_no_phase(case: Case, skews: Sequence[FloatArray]) -> bool:
    """Return whether the charge of all drives is later, or earlier, than message phases explain.

    skews : (m,) of each drive, what a charge that is late by 1 s changes
    """
    assert case.fixed is not None
    ends = np.cumsum([len(x) for x in skews])[:-1]
    whitened = np.split(errors(case, predict(case, case.fixed, (), ())), ends)
    pairs = zip(skews, whitened, strict=True)
    late_s = np.array([-(x @ e) / max(float(x @ x), 1e-12) for x, e in pairs])
    return bool(abs(late_s.mean()) > PHASE_MOST_S and (late_s * late_s.mean() > 0.0).all())
