"""Replays recordings through the pipeline as fast as possible."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import chain
from pathlib import Path
from typing import Any

import dbc
from monitor import __version__
from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.manifest import source_of
from monitor.base.signals import OUTPUT
from monitor.base.types import Sample
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.frames.candump import LogCounters
from monitor.frames.logs import read_frames
from monitor.grid.tables import is_table, read_table, table_block
from monitor.judge.limits import Limits
from monitor.memory.dtc import DtcStore
from monitor.memory.store import Memory
from monitor.model.card import ModelCard
from monitor.model.step import Model
from monitor.pipeline.entry import check_long_enough, check_received, frame_counts, table_counts
from monitor.pipeline.stream import CycleStarted, Event, FramePipeline, Monitor
from monitor.report.sinks import SCHEMA, Collector
from monitor.report.text import Trace

SHIPPED_MODEL = "shipped.onnx"


@dataclass(frozen=True, slots=True)
class Setup:
    """What every recording of a call is judged with."""

    model_path: Path
    model_sha256: str
    model: Model
    limits: Limits
    config: Config
    bus_map: BusMap
    columns: Path | None = None

    def of_vehicle(self, memory: Memory) -> "Setup":
        """Return the setup for the vehicle whose reference stands in the memory."""
        reference = memory.reference(self.model_sha256)
        return replace(self, limits=self.limits.of_vehicle(reference, self.config.bias))


def shipped_model() -> Path:
    """Return the path of the model that comes with the package."""
    return Path(str(files("monitor.model"))) / SHIPPED_MODEL


def set_up(
    model: Path | None,
    pairs: Sequence[tuple[Path, Path]],
    config: Config,
    columns: Path | None = None,
) -> Setup:
    """Return the setup; without a model the shipped one, without pairs the project's own ECU.

    Raises ModelError or SignalMapError.
    """
    path = model or shipped_model()
    loaded = Model.load(path)
    own = [(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))]
    bus_map = load_pairs(pairs or own)
    limits = Limits.from_card(loaded.card, config, str(path))
    return Setup(path, sha256_of(path), loaded, limits, config, bus_map, columns)


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file.

    Raises RecordingError if it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from None


@dataclass(frozen=True, slots=True)
class _Source:
    """One recording as events, with the monitor that judges it."""

    monitor: Monitor
    events: Iterator[Event]
    counters: Callable[[], dict[str, int]]  # what became of its frames


def _open(path: Path, setup: Setup, store: DtcStore) -> _Source:
    return (_open_table if is_table(path) else _open_log)(path, setup, store)


def _open_table(path: Path, setup: Setup, store: DtcStore) -> _Source:
    table = read_table(path, setup.columns)
    try:
        monitor = Monitor(setup.model, setup.limits, setup.config, table.names, store)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    block = table_block(table, table.names, setup.model.card.period_ns)
    counters = table_counts(table, block, setup.model.card)
    samples = map(Sample, block.index.tolist(), block.t_ns.tolist(), block.values, block.quality)
    return _Source(monitor, chain.from_iterable(map(monitor.push, samples)), lambda: counters)


def _open_log(path: Path, setup: Setup, store: DtcStore) -> _Source:
    log = LogCounters()
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
    return _Source(
        pipeline.monitor,
        pipeline.push_all(read_frames(path, log)),
        lambda: _log_counters(path, pipeline, log),
    )


def _log_counters(path: Path, pipeline: FramePipeline, log: LogCounters) -> dict[str, int]:
    check_received(path, pipeline.decoder.counters, log.frames)
    return frame_counters(pipeline) | {"skipped": log.skipped}


def frame_counters(pipeline: FramePipeline) -> dict[str, int]:
    """Return what became of frames that could not be used, by reason."""
    decoder = pipeline.decoder
    return frame_counts(decoder.counters, pipeline.assembler.counters, decoder.unmapped)


def replay(
    path: Path, setup: Setup, memory: Memory | None = None, *, trace: bool = False
) -> tuple[dict[str, Any], Trace]:
    """Judge one recording; a driving cycle begins with it, others where its samples show one.

    memory : fault memory and reference to go on from; without one both are empty
    Returns the recording's entry of ``o2mon.replay/1`` and its series (empty without ``trace``).
    Raises RecordingError, SignalMapError or ModelError.
    """
    sha256 = sha256_of(path)
    store = DtcStore(memory.load() if memory else None, setup.config.profile)
    store.start_driving_cycle()
    setup = setup.of_vehicle(memory) if memory else setup
    source = _open(path, setup, store)
    collector = Collector(source.monitor, trace=trace)
    for event in source.events:
        collector.push(event)
        if memory and isinstance(event, CycleStarted):
            memory.learn(setup.model_sha256, event.seen, setup.config.bias)
            source.monitor.adopt(setup.of_vehicle(memory).limits)
    check_long_enough(path, source.monitor.samples)
    recording = collector.result(str(path), sha256, source.counters())
    if memory:
        memory.save(store.saved)
        memory.learn(setup.model_sha256, source.monitor.seen, setup.config.bias)
    return recording | {"source": source_of(path, sha256)}, collector.trace()


def replay_all(
    paths: Iterable[Path], setup: Setup, memory: Memory | None = None, *, trace: bool = False
) -> Iterator[tuple[dict[str, Any], Trace]]:
    """Judge recordings one after the other, each with the model reset."""
    for path in paths:
        yield replay(path, setup, memory, trace=trace)


def exit_code(recordings: Sequence[dict[str, Any]]) -> int:
    """Return 1 if a fault was found, else 3 if a recording was not judged, else 0."""
    if any(r["fault_flag"] for r in recordings):
        return 1
    return 0 if all(r["completed"] for r in recordings) else 3


def result_of(recordings: list[dict[str, Any]], setup: Setup) -> dict[str, Any]:
    """Return the whole of ``o2mon.replay/1``, with what the verdicts rest on."""
    return {
        "schema": SCHEMA,
        "o2mon_version": __version__,
        "model": {"path": setup.model_path.name, "sha256": setup.model_sha256},
        "recordings": recordings,
    }


def trained_on(card: ModelCard) -> str:
    """Return in words where a model's training recordings come from."""
    sources = sorted({r.source or "source not said" for r in card.recordings})
    return ", ".join(sources) or "source not said"


def predicted_quantity(setup: Setup) -> str:
    """Return what the model predicts, as a page calls it."""
    name = setup.model.card.output.name
    return "lambda" if name == OUTPUT else name


def model_info(setup: Setup) -> dict[str, str]:
    """Return what the report says of the model."""
    card = setup.model.card
    layers = " and ".join(str(n) for n in card.layers)
    shape = f"lags {card.lags}, hidden layers {layers}" if layers else f"{card.lags} samples"
    return {
        "model": setup.model_path.name,
        "sha256": setup.model_sha256,
        "kind": f"{card.kind}, {shape}",
        "inputs": ", ".join(card.input_names),
        "output": card.output.name,
        "trained on": f"{len(card.recordings)} recordings ({trained_on(card)})",
        "sample period": f"{card.period_ns / 1e6:g} ms",
        "healthy residual": f"mean {card.residual_mean:+.4f}, std {card.residual_std:.4f}",
        "limits": ", ".join(f"{k} {v.value:.4g} {v.unit}" for k, v in card.limits.items()),
    }
