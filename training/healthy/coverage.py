"""Warnings of operating points where no healthy recording has been."""

from collections import Counter
from collections.abc import Sequence

from training.greybox.fit.drive import MIN_SCORED_S, ChainDrive
from training.healthy.behaviour import Healthy
from training.healthy.config import CONFIG as LIMITS
from training.pages.numbers import percent


def coverage_warnings(drives: Sequence[ChainDrive], known: Healthy | None) -> list[str]:
    """Return warnings of samples that name nothing: no healthy recording has been there."""
    if known is None:
        return []
    there = [int(d.kept.sum()) for d in drives]
    left = [int(known.known_of(d).kept.sum()) for d in drives]
    warnings = [
        f"{d.name}: left out of the naming, all but {n * d.period_s:.0f} s lie {_away([d], known)}"
        for d, n in zip(drives, left, strict=True)
        if n * d.period_s < MIN_SCORED_S
    ]
    share = 1.0 - sum(left) / max(sum(there), 1)
    if share >= LIMITS.unvisited_max:
        warnings.append(
            f"{percent(share)} of the samples lie {_away(drives, known)} and name nothing"
        )
    return warnings


def _away(drives: Sequence[ChainDrive], known: Healthy) -> str:
    """Return the quantity, in words, in which the drives left the healthy recordings' range."""
    outside = Counter[str]()
    for drive in drives:
        for what, within in known.visited.parts(known.with_own(drive)).items():
            outside[what] += int((~within[drive.kept]).sum())
    most = max(outside.values())
    where = " and ".join(
        what for what, n in outside.items() if n >= LIMITS.unvisited_reason_min * most
    )
    return f"at {where} that no healthy recording has visited"
