"""Recordings on disk, logs and tables, to blocks of samples on the model's grid."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.errors import CoarseTableError, MissingSignalsError
from monitor.base.signals import BY_NAME
from monitor.base.types import SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.decode.log_blocks import log_blocks
from monitor.frames.blocks import LogCounters
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, log_samples
from monitor.grid.column_times import unlike
from monitor.grid.table_samples import table_block
from monitor.grid.tables import BLANK, Table, is_table, read_table, rename
from monitor.grid.timeline import Timeline
from monitor.judge.causes.causes import SignalSource
from monitor.model.card import ModelCard
from monitor.pipeline.entry import bus_sources, check_received, frame_counts, table_counts
from monitor.pipeline.names import check_names, lacking_names, needed_names, needs

COARSE: Final = 1.5  # steps of the model's grid from which its response cannot be told between rows
OTHER_MODEL: Final = "train a model on healthy drives of this car: o2train fit LOG… --out M.onnx"


@dataclass(frozen=True, slots=True)
class OpenRecording:
    """A recording that is read block by block."""

    path: Path
    names: tuple[str, ...]  # signals of a sample
    parts: Iterator[SampleBlock | Clearing]
    counters: Callable[[], dict[str, int]]  # of frames that could not be used, behind the parts
    sources: Mapping[str, SignalSource]  # where each signal comes from
    is_live: Callable[[], bool] = lambda: False  # whether a live monitor made it, with its part
    profile: str = ""  # of a logger's file
    notes: Callable[[], tuple[str, ...]] = tuple  # oddities in words, behind the parts


class RecordingReader:
    """Reads logs and CSV tables.

    bus_map : for logs; columns : for CSV tables
    """

    def __init__(self, bus_map: BusMap, card: ModelCard, columns: Path | None = None) -> None:
        self._card, self._columns, self._bus_map = card, columns, bus_map
        self._names = needed_names(card, (*bus_map.names, *bus_map.optional))
        self._decoder = BlockDecoder(bus_map, self._names)
        self._sources = bus_sources(bus_map, self._names)

    def open(self, path: Path) -> OpenRecording:
        """Return a recording whose blocks are read when they are wanted, before the next one's.

        Raises RecordingError naming the file, or ConfigError for the columns map, here or while
        the blocks are read.
        """
        if not is_table(path):
            return self._log(path)
        return self.table(table_of_model(path, self._columns, self._card))

    def _log(self, path: Path) -> OpenRecording:
        check_names(self._card, self._names)
        log, decoder = LogCounters(), self._decoder
        decoder.restart()
        assembler = BlockAssembler.of(decoder, self._card.period_ns)
        timeline = Timeline(decoder)

        def counters() -> dict[str, int]:
            check_received(path, decoder.counters, log.frames)
            counts = frame_counts(decoder.counters, assembler.counters, decoder.unmapped)
            counts |= timeline.counters.found | {"skipped": log.skipped}
            if log.is_cut:
                counts["log_gaps"] = counts.get("log_gaps", 0) + 1
            return counts | ({"damaged_lines": log.damaged} if log.damaged else {})

        blocks = timeline.blocks(log_blocks(path, self._bus_map, log))
        parts = log_samples(blocks, decoder, assembler)
        return OpenRecording(
            path=path,
            names=self._names,
            parts=parts,
            counters=counters,
            sources=self._sources,
            is_live=lambda: assembler.is_live,
            notes=lambda: (*log.notes, *timeline.notes),
        )

    def table(self, table: Table) -> OpenRecording:
        """Return a table as a recording of one block.

        Raises RecordingError if it lacks a signal of the model or its rows are too far apart.
        """
        lacking = lacking_names(self._card, table.names)
        if lacking and table.profile:
            remedy = f"log {n} first" if (n := self._card.output.name) in lacking else OTHER_MODEL
            raise MissingSignalsError(
                f"{table.path}: the model needs {', '.join(lacking)}, which this log "
                f"({table.profile}) lacks{_blank(table, lacking)}; {remedy}"
            )
        if lacking:
            told = needs(lacking, table.names), rename(table)
            raise MissingSignalsError(f"{table.path}: {'; '.join(filter(None, told))}")
        step_ns = float(np.median(np.diff(table.t_ns))) if len(table.t_ns) > 1 else 0.0
        if step_ns > COARSE * self._card.period_ns:
            ms = 1.0 / COARSE < step_ns / 1000 / self._card.period_ns < COARSE
            remedy = "is its time in ms? s are wanted" if ms else f"log faster, or {OTHER_MODEL}"
            raise CoarseTableError(
                f"{table.path}: samples every {plain(step_ns / 1e9, 3)} s, the model needs them "
                f"every {self._card.period_ns / 1e9:g} s; {remedy}"
            )
        block = table_block(table, table.names, self._card.period_ns)
        self._check_times(table, block)
        counters = table_counts(table, block, self._card)
        sources = {name: SignalSource(table.column_of(name)) for name in table.names}
        return OpenRecording(
            table.path,
            table.names,
            iter([block]),
            lambda: counters,
            sources,
            profile=table.profile,
            notes=lambda: table.notes.lines,
        )

    def _check_times(self, table: Table, block: SampleBlock) -> None:
        """Raise CoarseTableError if the columns are written at other times than the model knows."""
        card = self._card
        names = (*card.input_names, card.output.name)
        places = [table.names.index(name) for name in names]
        period_s = card.period_ns / 1e9
        if card.times and (how := unlike(card.times, block.values[:, places], names, period_s)):
            raise CoarseTableError(
                f"{table.path}: {how}; log all of them each time, or {OTHER_MODEL}"
            )


def table_of_model(path: Path, columns: Path | None, card: ModelCard) -> Table:
    """Return a table with the columns that a model needs, of a logger's file by its profile.

    columns : columns map or profile, before that of the model
    Raises as ``read_table``.
    """
    further = [name for name in (*card.input_names, card.output.name) if name not in BY_NAME]
    return read_table(path, columns, further, card.profile)


def _blank(table: Table, lacking: Sequence[str]) -> str:
    """Return in words which columns are there, but tell nothing."""
    columns = [table.blank[name] for name in lacking if name in table.blank]
    return f" (column {f' {BLANK}, column '.join(columns)} {BLANK})" if columns else ""
