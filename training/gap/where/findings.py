"""Where a model and a healthy vehicle disagree: in which regime and band, and since when.

With healthy recordings on which the model was accepted, everything is what comes on top of the
errors that the model already makes there; without them, what comes on top of the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from training.gap.where.bands import Bands, find_bands
from training.gap.where.bootstrap import Excess, excess
from training.gap.where.candidates import Side
from training.gap.where.noise_floor import NoiseFloor, noise_floor
from training.gap.where.operating_map import Excerpt, OperatingMap, excerpt, operating_map
from training.gap.where.over_time import Change, find_changes
from training.gap.where.regimes import (
    LIMITS,
    Regime,
    between_recordings,
    explained_by,
    find_regimes,
    rivals,
)
from training.gap.where.transport import find_transport, like
from training.greybox.fit.comparison import FOLDS, Comparison, Stack, stack

MOST_NAMED: Final = 4  # rivals in a sentence; the page shows them all


@dataclass(frozen=True, slots=True)
class Findings:
    """Regimes, bands and changes in which the residual exceeds the reference."""

    samples: int  # scored
    floor: NoiseFloor
    excess: Excess
    offset: Regime  # what a constant explains; the regimes come on top of it
    regimes: tuple[Regime, ...]  # every driver and point, what explains most first
    rivals: tuple[Regime, ...]  # not told from the first
    bands: Bands | None  # None where unbroken stretches are too short
    changes: tuple[Change, ...]
    map: OperatingMap | None  # None where no signal of speed or load moves
    excerpt: Excerpt
    notes: tuple[str, ...]  # what was assumed, and what could not be looked at

    @property
    def significant(self) -> tuple[str, ...]:
        """Return one sentence per kind of finding, the best of it, if that is beyond chance."""
        found = [self.offset.sentence] if self.offset.significant else []
        if self.regimes and self.regimes[0].significant:
            found.append(self.regimes[0].sentence + self._not_told())
        if self.bands is not None and self.bands.strongest is not None:
            found.append(self.bands.strongest.sentence)
        return (*found, *(change.sentence for change in self.changes if change.significant))

    def _not_told(self) -> str:
        names = list(dict.fromkeys(f"{r.words} ({r.point})" for r in self.rivals))
        if not names:
            return ""
        more = f"; and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        return f" These recordings do not tell it from: {'; '.join(names[:MOST_NAMED])}{more}."

    def where(self) -> list[dict[str, Any]]:
        """Return the entries of ``where`` in the gap report, regimes before bands."""
        entries = [
            {
                **_share("regime", r),
                "driver": r.driver,
                "point": r.point,
                "p_value": r.p_value,
                "separated": r.separated,
            }
            for r in (self.offset, *self.regimes)
            if r.significant
        ]
        if self.bands is not None:
            entries += [
                {**_share("band", b), "band_hz": [b.low_hz, b.high_hz]}
                for b in self.bands.bands
                if b.significant
            ]
        return entries


def _share(kind: str, finding: Any) -> dict[str, Any]:
    share = finding.share
    return {
        "kind": kind,
        "regime": finding.sentence,
        "share_of_excess": share.value,
        "share_low": share.low,
        "share_high": share.high,
    }


def localise(
    recordings: Sequence[Comparison], healthy: Sequence[Comparison] = (), seed: int = 0
) -> Findings:
    """Return where the recordings' residuals exceed the noise, or those of healthy recordings.

    healthy : recordings on which the model was accepted, with its predictions
    Raises RecordingError if periods differ or too little is scored.
    """
    periods = {r.period_s for r in (*recordings, *healthy)}
    if len(periods) > 1:
        raise RecordingError(f"periods of {sorted(periods)} s, one period is wanted")
    rng = np.random.default_rng(seed)
    blocks = stack(recordings)
    known = stack(healthy) if healthy else None
    floor = noise_floor(recordings, blocks, rng)
    over = _excess(blocks, known, floor, rng)
    transport = find_transport(recordings)
    new = Side.of(recordings, blocks, transport)
    other = None if known is None else Side.of(healthy, known, like(transport, healthy))
    offset, regimes = find_regimes(new, other, over, rng)
    best = regimes[0] if regimes and regimes[0].significant else None
    pair = None if known is None else (healthy, known)
    explained = None if best is None else explained_by(best, new)
    return Findings(
        samples=len(blocks.residual),
        floor=floor,
        excess=over,
        offset=offset,
        regimes=regimes,
        rivals=rivals(regimes, over),
        bands=find_bands(recordings, healthy, floor.white_rms, rng),
        changes=find_changes(recordings, healthy, explained, rng),
        map=operating_map(recordings, blocks, pair, over.reference),
        excerpt=excerpt(recordings, explained),
        notes=_notes(new, other),
    )


def _excess(
    blocks: Stack, known: Stack | None, floor: NoiseFloor, rng: np.random.Generator
) -> Excess:
    """Return the excess over healthy recordings, or over the noise floor."""
    squares, samples = blocks.sums(blocks.residual**2), blocks.sums(np.ones(len(blocks.residual)))
    reference: tuple[FloatArray, FloatArray] | float = floor.rms**2
    if known is not None:
        reference = (known.sums(known.residual**2), known.sums(np.ones(len(known.residual))))
    return excess(squares, samples, reference, floor.white_rms**2, rng)


def _notes(new: Side, healthy: Side | None) -> tuple[str, ...]:
    notes = []
    if healthy is None:
        notes.append(
            "No healthy recordings were given: errors that the model has made from the start count "
            "as excess."
        )
    else:
        lacking = sorted(set(new.drivers) - set(healthy.drivers))
        if lacking:
            notes.append(
                f"Not looked at, because healthy recordings lack them: {', '.join(lacking)}."
            )
    few = between_recordings(new)
    if few:
        names = ", ".join(new.drivers[name].words for name in few)
        notes.append(
            f"Not looked at, because they differ between these few recordings more than within "
            f"them: {names}. With {FOLDS} recordings or more they are, with "
            f"{LIMITS.recordings_many} also what is constant in each."
        )
    if new.transport is None:
        notes.append(
            "Fuel or air per stroke is missing and the model has no chain of its own: what acts "
            "before the transport could not be told from what acts at the sensor."
        )
    else:
        notes.append(f"Transport to the sensor: {new.transport.source}.")
    return tuple(notes)
