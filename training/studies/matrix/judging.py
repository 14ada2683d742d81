"""Drives through the monitor, and what a vehicle's reference learns of them."""

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
    """Return the verdict on each drive, judged with its vehicle's reference and empty memory.

    references : of each drive's vehicle, None where nothing is known of it
    """
    known = [reference or Reference() for reference in references or [None] * len(blocks)]
    return judge_all(blocks, names, model, limits, config, references=known)


def learn(reference: Reference | None, judged: Judged, config: Config) -> Reference:
    """Return the reference after one more drive, as the monitor learns it."""
    known = reference or Reference()
    return known if judged.seen is None else known.learn(judged.seen, config.bias)


def to_json(reference: Reference) -> dict[str, Any]:
    """Return the reference as JSON has it."""
    return asdict(reference)


def from_json(tree: dict[str, Any] | None) -> Reference | None:
    """Return the reference that ``to_json`` wrote."""
    return None if tree is None else Reference(**tree)
