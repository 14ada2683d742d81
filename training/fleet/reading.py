"""Read a recording of any format onto the sample grid of the model."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.files.manifest import sha256_of
from monitor.base.types import SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge.enable import Enable
from monitor.pipeline.entry import check_long_enough
from monitor.pipeline.names import needed_names
from training.fleet.worker_kit import Tools
from training.recordings import recording
from training.recordings.files.measurement import is_measurement


@dataclass(frozen=True, slots=True)
class Read:
    """One recording on the sample grid of the model."""

    names: tuple[str, ...]
    block: SampleBlock
    begin_ns: int  # time of the first sample on the clock of the file
    clearings: tuple[Clearing, ...]
    counters: Mapping[str, int]
    unavailable: tuple[str, ...]  # enable conditions whose signals the recording lacks
    sha256: str  # of the file
    size_bytes: int


def samples_of(path: Path, tools: Tools) -> Read:
    """Return the samples of a log or table like ``o2mon replay``, or of a measurement file.

    Raises RecordingError with the name of the file, or ConfigError for the columns map.
    """
    card, counters, clearings = tools.model.card, dict[str, int](), tuple[Clearing, ...]()
    if is_measurement(path, tools.columns):
        names, block, begin_ns = _measured(path, tools)
    else:
        opened = tools.reader.open(path)
        samples, clearings = recording.whole(opened.parts, len(opened.names))
        check_long_enough(path, len(samples.t_ns))
        names, counters = needed_names(card, opened.names), opened.counters()
        order = [opened.names.index(name) for name in names]
        values, quality = samples.values[:, order], samples.quality[:, order]
        block, begin_ns = samples._replace(values=values, quality=quality), int(samples.t_ns[0])
    unavailable = Enable.of(tools.config.enable, names, card).unavailable
    file = sha256_of(path), path.stat().st_size
    return Read(names, block, begin_ns, clearings, counters, unavailable, *file)


def _measured(path: Path, tools: Tools) -> tuple[tuple[str, ...], SampleBlock, int]:
    card = tools.model.card
    table = recording.load(path, period_s=card.period_ns / 1e9, columns=tools.columns)
    names = needed_names(card, table.names)
    wanted = (*card.input_names, card.output.name)
    empty = [name for name in wanted if not np.isfinite(table.column(name)).any()]
    if empty:
        raise RecordingError(f"{path}: no number in column {', '.join(empty)}")
    order = [table.names.index(name) for name in names]
    t_ns = np.rint(table.t_s * 1e9).astype(np.int64)
    values = (table.values[:, order], table.quality[:, order])
    return names, SampleBlock(np.arange(len(t_ns)), t_ns, *values), table.begin_ns
