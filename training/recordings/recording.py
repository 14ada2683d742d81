"""Recordings for training: logs and tables of every kind on one grid, through the runtime's code.

Logs and tables pass through the same code as in ``o2mon replay``.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

import dbc
from monitor.base.counts import duration
from monitor.base.errors import RecordingError, UsageError
from monitor.base.files.manifest import entry_of, sha256_of
from monitor.base.signals import BY_NAME
from monitor.base.types import FloatArray, IntArray, Quality, QualityArray, SampleBlock, Shown
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.decode.log_blocks import log_blocks
from monitor.frames.blocks import LogCounters
from monitor.grid.arrays import table_of
from monitor.grid.block_assembler import BlockAssembler, assemble_arrays, joined
from monitor.grid.block_samples import Clearing, log_samples
from monitor.grid.table_samples import in_range, table_block
from monitor.grid.tables import DEFAULT_PERIOD_NS, Table, is_table, read_table, table_period_ns
from monitor.grid.timeline import Timeline
from monitor.model.card import TrainingRecording
from training.recordings.files.measurement import is_measurement, read_measurement
from training.recordings.files.table_files import write_table

__all__ = ["Recording", "default_pairs", "load", "log_block", "write_table"]

Pairs = Sequence[tuple[str | Path, str | Path]]
Samples = tuple[tuple[str, ...], int, SampleBlock]  # names, period in ns, samples
ROWS_APART_MOST_S: Final = 60.0  # in the median


@dataclass(frozen=True, slots=True, repr=False)
class Recording(Shown):
    """One drive on one grid."""

    path: Path
    sha256: str  # of the file
    period_ns: int
    t_s: FloatArray  # (n,) seconds since the first sample
    names: tuple[str, ...]
    values: FloatArray  # (n, n_names), NaN where not good
    quality: QualityArray  # (n, n_names)
    profile: str = ""  # of a logger's file
    notes: tuple[str, ...] = ()  # oddities of a table, in words
    begin_ns: int = 0  # time of the first sample on the clock of the file

    @property
    def facts(self) -> dict[str, object]:
        """Return file, length, period and signals."""
        n, period_s = len(self.t_s), self.period_ns / 1e9
        size = f"{n} of {period_s:g} s, {duration(n * period_s)}"
        return {"file": self.path, "samples": size, "signals": " ".join(self.names)}

    @property
    def read_sha256(self) -> str:
        """Hash of the samples: the same file read with another map or grid has another one."""
        tree = [self.sha256, self.period_ns, self.names]
        read = hashlib.sha256(json.dumps(tree).encode())
        for each in (self.t_s, self.values, self.quality):
            read.update(each.tobytes())
        return read.hexdigest()

    def column(self, name: str) -> FloatArray:
        """Return one signal, (n,); raises RecordingError if there is no such name."""
        if name not in self.names:
            raise RecordingError(f"{self.path}: has no {name}, there are {', '.join(self.names)}")
        return self.values[:, self.names.index(name)]

    def part(self, first: int, stop: int) -> "Recording":
        """Return the samples first .. stop - 1; file and times stay those of the whole."""
        rows = slice(first, stop)
        values, quality = self.values[rows], self.quality[rows]
        return replace(self, t_s=self.t_s[rows], values=values, quality=quality)

    @property
    def entry(self) -> Mapping[str, Any]:
        """Return what the manifest.json beside the file says of it, nothing without one."""
        return entry_of(self.path, self.sha256)

    @property
    def known(self) -> frozenset[str]:
        """Return the signals that have a good value."""
        good = np.flatnonzero(np.isfinite(self.values).any(axis=0))
        return frozenset(self.names[i] for i in good.tolist())


def load(
    path: str | Path,
    names: Sequence[str] | None = None,
    *,
    period_s: float | None = None,
    pairs: Pairs | None = None,
    channel: str = "",
    columns: str | Path | None = None,
    of_model: Mapping[str, Any] | None = None,
) -> Recording:
    """Return the recording in ``path``, a CAN log or a table.

    names : the signals to read, in this order; None for all of them
    period_s : grid period; None is 100 ms for logs and a table's own if it is uniform
    pairs : pairs of DBC and signal map for logs, default the project's own ECU
    channel : of logs that hold several buses, before that of a signal map
    columns : columns map or profile for tables, columns map for measurement files
    of_model : tree of the profile in a model's card, for a logger's file that it fits
    Raises RecordingError or SignalMapError naming the file and what is wrong.
    """
    path, period_ns = Path(path), _in_ns(period_s)
    wanted = None if names is None else tuple(names)
    profile, notes = "", tuple[str, ...]()
    if is_measurement(path, columns):
        read = _from_measurement(path, wanted, period_ns, columns)
    elif is_table(path):
        further = [n for n in wanted or () if n not in BY_NAME]
        table = read_table(path, columns, further, of_model)
        profile, notes = table.profile, table.notes.lines
        read = _from_table(table, wanted, period_ns)
    else:
        bus_map = load_pairs(default_pairs() if pairs is None else pairs, channel)
        got, period_ns = wanted or bus_map.names, period_ns or DEFAULT_PERIOD_NS
        log = LogCounters()
        block = log_block(path, bus_map, got, period_ns, log)
        read, notes = (got, period_ns, block), tuple(log.notes)
        if block.quality.size and (block.quality != Quality.GOOD).all():
            raise RecordingError(
                f"{path}: no frame holds a good value of {', '.join(got[:3])}"
                f"{', …' if len(got) > 3 else ''}; wrong --dbc or --map?"
            )
    return _of_samples(path, sha256_of(path), read, profile, notes)


def of_columns(columns: Any, name: str, period_s: float | None = None) -> Recording:
    """Return columns in memory as a recording.

    columns : dict of arrays, or a frame of polars or pandas, with ``time_s`` among them
    name : of the recording in results and messages
    period_s : as in ``load``
    Raises RecordingError naming the recording and what is wrong.
    """
    table = table_of(columns, name)
    read = _from_table(table, None, _in_ns(period_s))
    content = json.dumps(table.names).encode() + table.t_ns.tobytes() + table.values.tobytes()
    digest, notes = hashlib.sha256(content).hexdigest(), table.notes.lines
    return _of_samples(table.path, digest, read, "", notes)


def _in_ns(period_s: float | None) -> int | None:
    if period_s is not None and not 1e-9 <= period_s < math.inf:
        raise UsageError(f"a sample period of {period_s} s, above 0 is wanted")
    return None if period_s is None else round(period_s * 1e9)


def _of_samples(
    path: Path, digest: str, read: Samples, profile: str, notes: tuple[str, ...]
) -> Recording:
    """Return samples as a recording; raises RecordingError if there is none."""
    names, period_ns, block = read
    if len(block.t_ns) == 0:
        raise RecordingError(f"{path}: too short for one sample of {period_ns / 1e9:g} s")
    begin_ns = int(block.t_ns[0])
    t_s, values = (block.t_ns - begin_ns) / 1e9, (block.values, block.quality)
    return Recording(path, digest, period_ns, t_s, names, *values, profile, notes, begin_ns)


def check_each_once(recordings: Sequence[Recording]) -> None:
    """Raise UsageError if there is none, or two have the same content, under any name."""
    if not recordings:
        raise UsageError("no recordings: one or more are wanted")
    seen: dict[str, Path] = {}
    for each in recordings:
        if each.sha256 in seen:
            raise UsageError(f"{each.path}: the same as {seen[each.sha256]}")
        seen[each.sha256] = each.path


def check_rows(path: Path, t_ns: IntArray) -> None:
    """Raise RecordingError if a table's rows lie more than 60 s apart: not seconds, it seems."""
    apart_s = float(np.median(np.diff(t_ns))) / 1e9 if len(t_ns) > 1 else 0.0
    if apart_s > ROWS_APART_MOST_S:
        raise RecordingError(
            f"{path}: rows are {apart_s:g} s apart, at most {ROWS_APART_MOST_S:g} s are wanted; "
            'for times in ms give --columns with time_s = { column = "time_s", factor = 0.001 }'
        )


def _from_table(table: Table, names: tuple[str, ...] | None, period_ns: int | None) -> Samples:
    check_rows(table.path, table.t_ns)
    names = table.names if names is None else names
    return names, table_period_ns(table, period_ns), table_block(table, names, period_ns)


def _from_measurement(
    path: Path, names: tuple[str, ...] | None, period_ns: int | None, columns: str | Path | None
) -> Samples:
    """Return a measurement file's samples; channels at one raster are a table."""
    series = read_measurement(path, columns)
    names = tuple(series) if names is None else names
    missing = [name for name in names if name not in series]
    if missing:
        raise RecordingError(f"{path}: has no channel {', '.join(missing)}")
    chosen = {name: series[name] for name in names}
    times_ns = np.unique(np.concatenate([t_ns for t_ns, _ in chosen.values()]))  # of any channel
    if all(np.array_equal(t_ns, times_ns) for t_ns, _ in chosen.values()):
        values = np.column_stack([each for _, each in chosen.values()])
        return _from_table(Table(path, names, times_ns, values), names, period_ns)
    period_ns = period_ns or DEFAULT_PERIOD_NS
    marked, timeouts_ns = [], []
    for name, (t_ns, each) in chosen.items():
        values, quality = in_range(each[:, np.newaxis], [name])
        marked.append((t_ns, np.where(quality == Quality.OUT_OF_RANGE, np.inf, values)[:, 0]))
        step_ns = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0
        timeouts_ns.append(max(500_000_000, 3 * step_ns))
    block = assemble_arrays(
        times_ns, marked, names, names, period_ns=period_ns, timeouts_ns=timeouts_ns
    )
    return names, period_ns, block


def default_pairs() -> Pairs:
    """Return DBC and signal map of the project's own ECU."""
    return [(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))]


def log_block(
    path: Path,
    bus_map: BusMap,
    names: Sequence[str],
    period_ns: int,
    log: LogCounters | None = None,
) -> SampleBlock:
    """Return the samples of a CAN log, the same as those of the streaming pipeline.

    log : counts its frames
    """
    decoder = BlockDecoder(bus_map, names)
    assembler = BlockAssembler.of(decoder, period_ns)
    blocks = Timeline(decoder).blocks(log_blocks(path, bus_map, log))
    return whole(log_samples(blocks, decoder, assembler), len(names))[0]


def training_recording(recording: Recording, n_samples: int | None = None) -> TrainingRecording:
    """Return a recording as model cards and results name it, with its source.

    n_samples : samples that were used; default all of them
    """
    used = len(recording.values) if n_samples is None else n_samples
    source = recording.entry.get("source") or ""
    return TrainingRecording(recording.path.name, recording.sha256, used, source)


def whole(
    parts: Iterable[SampleBlock | Clearing], n_names: int
) -> tuple[SampleBlock, tuple[Clearing, ...]]:
    """Return a recording's samples as one block, and its clearings."""
    taken = list(parts)
    clearings = tuple(each for each in taken if isinstance(each, Clearing))
    return joined([each for each in taken if not isinstance(each, Clearing)], n_names), clearings
