"""Verdicts of the monitor on drives, and the reference that a vehicle learns from its drives."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from monitor.base.config import Config
from monitor.base.types import SampleBlock
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.side_by_side import Judged, judge_all


def judge_drives(
    blocks: Sequence[SampleBlock],
    names: Sequence[str],
    model: Model,
    limits: Limits,
    config: Config,
    references: Sequence[Reference | None] | None = None,
) -> list[Judged]:
    """Return the verdicts on drives, with an empty fault memory for every drive.

    names : column names of the blocks
    references : one per drive, the reference of its vehicle; None means a new reference
    """
    known = [reference or Reference() for reference in references or [None] * len(blocks)]
    return judge_all(blocks, names, model, limits, config, references=known)


def learn(reference: Reference | None, judged: Judged, config: Config) -> Reference:
    """Return the vehicle's reference after one more drive, by the monitor's rule."""
    known = reference or Reference()
    return known if judged.seen is None else known.learn(judged.seen, config.bias)


def to_json(reference: Reference) -> dict[str, Any]:
    """Return the reference as JSON values."""
    return asdict(reference)


def from_json(tree: dict[str, Any] | None) -> Reference | None:
    """Return the reference that ``to_json`` wrote."""
    return None if tree is None else Reference(**tree)
