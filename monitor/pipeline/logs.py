"""Recordings on disk to verdicts, many side by side: what ``replay`` says of each without a memory.

Some recordings at a time are read onto the model's grid and judged together, so that memory stays
the same however many there are. A recording that cannot be used is its error, and the others go on.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.types import SampleBlock
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap
from monitor.frames.candump import LogCounters
from monitor.frames.candump_blocks import Parser
from monitor.frames.log_blocks import read_blocks
from monitor.grid.block_assembler import BlockAssembler
from monitor.grid.block_samples import Clearing, log_samples
from monitor.grid.tables import is_table, read_table, table_block
from monitor.judge.enable import Enable
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.block_judge import BlockJudge, Judged
from monitor.pipeline.entry import (
    check_long_enough,
    check_received,
    dtc_entry,
    enable_shares,
    frame_counts,
    limits_entry,
    table_counts,
    window_entry,
)
from monitor.pipeline.stream import check_names, needed_names


@dataclass(frozen=True, slots=True)
class ReadRecording:
    """A recording on the model's grid."""

    path: Path
    names: tuple[str, ...]  # what each sample holds
    block: SampleBlock
    clearings: tuple[Clearing, ...]
    counters: Mapping[str, int]  # what became of its frames


@dataclass(frozen=True, slots=True)
class JudgedRecording:
    """What is said of one recording: either its entry or the reason why there is none."""

    path: Path
    entry: dict[str, Any] | None = None  # of ``o2mon.replay/1``, without sha256 and source
    error: RecordingError | None = None


class RecordingReader:
    """Reads logs and CSV tables as the streaming monitor does."""

    def __init__(
        self,
        bus_map: BusMap,
        card: ModelCard,
        columns: Path | None = None,
        parse: Parser | None = None,  # of candump text, instead of numpy's
    ) -> None:
        self._card, self._columns, self._parse = card, columns, parse
        self._names = needed_names(card, bus_map.names)
        self._decoder = BlockDecoder(bus_map, self._names)

    def read(self, path: Path) -> ReadRecording:
        """Return a recording's samples.

        Raises RecordingError naming the file, or ConfigError for the columns map.
        """
        return self._table(path) if is_table(path) else self._log(path)

    def _log(self, path: Path) -> ReadRecording:
        check_names(self._card, self._names)
        log, decoder = LogCounters(), self._decoder
        decoder.restart()
        assembler = BlockAssembler.of(decoder, self._card.period_ns)
        found = log_samples(read_blocks(path, log, self._parse), decoder, assembler)
        check_long_enough(path, len(found.samples.t_ns))
        check_received(path, decoder.counters, log.frames)
        counters = frame_counts(decoder.counters, assembler.counters, decoder.unmapped)
        counters["skipped"] = log.skipped
        return ReadRecording(path, self._names, found.samples, found.clearings, counters)

    def _table(self, path: Path) -> ReadRecording:
        table = read_table(path, self._columns)
        try:
            check_names(self._card, table.names)
        except RecordingError as error:
            raise RecordingError(f"{path}: {error}") from None
        block = table_block(table, table.names, self._card.period_ns)
        counters = table_counts(table, block, self._card)
        check_long_enough(path, len(block.t_ns))
        names = needed_names(self._card, table.names)
        order = [table.names.index(name) for name in names]
        block = block._replace(values=block.values[:, order], quality=block.quality[:, order])
        return ReadRecording(path, names, block, (), counters)


def judge_logs(
    paths: Iterable[Path],
    bus_map: BusMap,
    model: Model,
    limits: Limits,
    config: Config,
    *,
    columns: Path | None = None,
    side_by_side: int = 64,
    parse: Parser | None = None,
) -> Iterator[JudgedRecording]:
    """Yield what is said of each recording, in the order of the paths.

    bus_map : for logs; columns : for CSV tables; side_by_side : recordings held at once; parse : of
    candump text, instead of numpy's
    Each is judged as a drive of a vehicle of which nothing is known, with an empty fault memory.
    Raises SignalMapError or ConfigError if none could be read.
    """
    reader = RecordingReader(bus_map, model.card, columns, parse)
    judges = _Judges(model, limits, config, side_by_side)
    rest = iter(paths)
    while chosen := list(islice(rest, side_by_side)):
        found: dict[int, JudgedRecording] = {}
        read: dict[int, ReadRecording] = {}
        for number, path in enumerate(chosen):
            try:
                read[number] = reader.read(path)
            except RecordingError as error:
                found[number] = JudgedRecording(path, error=error)
        for number, each, judged in judges.judge(read):
            unavailable = Enable.of(config.enable, each.names, model.card).unavailable
            found[number] = JudgedRecording(each.path, entry_of(each, judged, unavailable))
        yield from (found[number] for number in range(len(chosen)))


class _Judges:
    """Judges for recordings with different signals, each made when it is needed."""

    def __init__(self, model: Model, limits: Limits, config: Config, rows: int) -> None:
        self._make = partial(
            BlockJudge, model=model, limits=limits, config=config, rows=rows, keep_banks=False
        )
        self._judges: dict[tuple[str, ...], BlockJudge] = {}

    def judge(
        self, read: Mapping[int, ReadRecording]
    ) -> Iterator[tuple[int, ReadRecording, Judged]]:
        """Yield recordings with what is made of them, those with the same signals together."""
        alike: dict[tuple[str, ...], list[int]] = {}
        for number, each in read.items():
            alike.setdefault(each.names, []).append(number)
        for names, numbers in alike.items():
            if names not in self._judges:
                self._judges[names] = self._make(names)
            judged = self._judges[names].judge(
                [read[i].block for i in numbers], clearings=[read[i].clearings for i in numbers]
            )
            yield from ((i, read[i], each) for i, each in zip(numbers, judged, strict=True))


def entry_of(read: ReadRecording, judged: Judged, unavailable: Sequence[str]) -> dict[str, Any]:
    """Return the recording's entry of ``o2mon.replay/1``.

    unavailable : enable conditions whose signals the recording does not have
    """
    t0_ns, n = int(read.block.t_ns[0]), len(read.block.t_ns)
    held = judged.conditions.sum(axis=0).tolist()
    return {
        "path": str(read.path),
        "sha256": None,
        "samples": n,
        "enabled_samples": int(judged.enabled.sum()),
        "windows": [window_entry(window, t0_ns) for window in judged.windows],
        "windows_interrupted": judged.interrupted_windows,
        "windows_dropped": 0,
        "dtcs": [dtc_entry(dtc, t0_ns) for dtc in judged.dtcs],
        "fault_flag": bool(judged.dtcs),
        "completed": judged.completed,
        "enable": enable_shares(held, n, unavailable),
        "limits": limits_entry(judged.limits),
        "counters": dict(read.counters),
    }
