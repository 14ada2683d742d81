"""A recording of any kind on the model's grid, as the monitor reads it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.types import SampleBlock
from monitor.grid.block_samples import Clearing
from monitor.judge.enable import Enable
from monitor.model.card import ModelCard
from monitor.pipeline.monitor import needed_names
from monitor.pipeline.recordings import RecordingReader
from training.recordings import recording
from training.recordings.measurement import is_measurement


@dataclass(frozen=True, slots=True)
class Read:
    """One recording on the model's grid."""

    names: tuple[str, ...]
    block: SampleBlock
    clearings: tuple[Clearing, ...]
    counters: Mapping[str, int]
    unavailable: tuple[str, ...]  # enable conditions whose signals it does not have
    sha256: str
    size_bytes: int


class FleetReader:
    """Reads what ``o2mon replay`` reads, and parquet tables and measurement files."""

    def __init__(
        self, reader: RecordingReader, card: ModelCard, config: Config, columns: Path | None
    ) -> None:
        self._reader, self._card, self._columns = reader, card, columns
        self._config = config

    def read(self, path: Path) -> Read:
        """Return a recording's samples.

        Raises RecordingError naming the file, or ConfigError for the columns map.
        """
        counters: Mapping[str, int] = {}
        clearings: tuple[Clearing, ...] = ()
        if path.suffix.lower() == ".parquet" or is_measurement(path, self._columns):
            names, block = self._load(path)
        else:
            found = self._reader.read(path)
            names, block = found.names, found.block
            counters, clearings = found.counters, found.clearings
        return Read(
            names,
            block,
            clearings,
            counters,
            Enable.of(self._config.enable, names, self._card).unavailable,
            recording.sha256(path),
            path.stat().st_size,
        )

    def _load(self, path: Path) -> tuple[tuple[str, ...], SampleBlock]:
        period_s = self._card.period_ns / 1e9
        found = recording.load(path, period_s=period_s, columns=self._columns)
        names = needed_names(self._card, found.names)
        wanted = (*self._card.input_names, self._card.output.name)
        empty = [
            name for name in wanted if name in names and not np.isfinite(found.column(name)).any()
        ]
        if empty:
            raise RecordingError(f"{path}: no number in column {', '.join(empty)}")
        order = [found.names.index(name) for name in names]
        t_ns = np.rint(found.t_s * 1e9).astype(np.int64)
        index = np.arange(len(t_ns))
        return names, SampleBlock(index, t_ns, found.values[:, order], found.quality[:, order])
