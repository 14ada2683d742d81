"""Judges drives with the monitor, and learns the references of their vehicles."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from monitor.base.config import Config
from monitor.base.types import SampleBlock
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference
from monitor.model.step import Model
from monitor.pipeline.block_judge import Judged, judge_all


def judge_drives(
    blocks: Sequence[SampleBlock],
    names: Sequence[str],
    model: Model,
    limits: Limits,
    config: Config,
    references: Sequence[Reference | None] | None = None,
) -> list[Judged]:
    """Return the verdict on each drive, with its vehicle's reference and an empty memory.

    references : reference of each drive's vehicle, None if it has none
    """
    known = [reference or Reference() for reference in references or [None] * len(blocks)]
    return judge_all(blocks, names, model, limits, config, references=known)


def learn(reference: Reference | None, judged: Judged, config: Config) -> Reference:
    """Return the reference after one more drive, learned as in the monitor."""
    known = reference or Reference()
    return known if judged.seen is None else known.learn(judged.seen, config.bias)


def to_json(reference: Reference) -> dict[str, Any]:
    """Return the reference as JSON values."""
    return asdict(reference)


def from_json(tree: dict[str, Any] | None) -> Reference | None:
    """Return the reference from the JSON of ``to_json``."""
    return None if tree is None else Reference(**tree)
