"""Replays recordings through the pipeline as fast as possible."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import dbc
from monitor import __version__
from monitor.base.config import Config, ProfileConfig
from monitor.base.errors import MissingSignalsError
from monitor.base.files.manifest import entry_of, sha256_of
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.grid.block_samples import Clearing
from monitor.grid.tables import Table, is_table
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.memory.dtc_store import DtcStore
from monitor.memory.store import Memory
from monitor.model.step import Model
from monitor.pipeline import without_model
from monitor.pipeline.collector import Collector, Trace
from monitor.pipeline.entry import check_long_enough
from monitor.pipeline.events import BlockEvent, CycleStarted
from monitor.pipeline.monitor import Judge, SensorMonitor, slices
from monitor.pipeline.recordings import OpenRecording, RecordingReader, table_of_model

Listeners = Callable[[SensorMonitor], Callable[[BlockEvent], None]]
SCHEMA = "o2mon.replay/1"
SHIPPED_MODEL = "shipped.onnx"


@dataclass(frozen=True, slots=True)
class Setup:
    """Model, settings and signals with which all recordings of a call are judged."""

    model: Model
    limits: Limits
    config: Config
    bus_map: BusMap
    columns: Path | None = None

    def of_vehicle(self, memory: Memory) -> "Setup":
        """Return the setup for the vehicle whose reference stands in the memory."""
        reference = memory.reference(self.model.sha256)
        return replace(self, limits=self.limits.of_vehicle(reference, self.config.bias))


def shipped_model() -> Path:
    """Return the path of the model that comes with the package."""
    return Path(str(files("monitor.model"))) / SHIPPED_MODEL


def set_up(
    model: str | Path | Model | None,
    pairs: Sequence[tuple[Path, Path]],
    config: Config,
    columns: Path | None = None,
    *,
    judges: bool = True,
    channel: str = "",
) -> Setup:
    """Return the setup; without a model the shipped one, without pairs the project's own ECU.

    judges : whether the model must have decision limits
    channel : of logs that hold several buses, before that of a signal map
    Raises ModelError or SignalMapError.
    """
    loaded = model if isinstance(model, Model) else Model.load(model or shipped_model())
    own = [(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))]
    bus_map = load_pairs(pairs or own, channel)
    is_bare = not judges and not loaded.card.limits
    limits = NO_LIMITS if is_bare else Limits.from_card(loaded.card, config, str(loaded.path))
    return Setup(loaded, limits, config.with_catalyst(bus_map.catalyst_position), bus_map, columns)


def replay(
    path: Path,
    setup: Setup,
    memory: Memory | None = None,
    *,
    trace: bool = False,
    listeners: Listeners | None = None,
) -> tuple[dict[str, Any], Trace]:
    """Judge one recording; a driving cycle begins with it, others where its samples show one.

    memory : fault memory and reference to go on from; without one both are empty
    listeners : gives for its monitor a function that takes the events, too
    Returns the recording's entry of ``o2mon.replay/1`` and its series (empty without ``trace``).
    Raises RecordingError, SignalMapError or ModelError.
    """
    if is_table(path):
        table = table_of_model(path, setup.columns, setup.model.card)
        pair = judged_table(table, sha256_of(path), setup, memory, trace=trace, listeners=listeners)
    else:
        opened = RecordingReader(setup.bus_map, setup.model.card).open(path)
        pair = judged(opened, sha256_of(path), setup, memory, trace=trace, listeners=listeners)
    return pair[0] | {"source": entry_of(path, pair[0]["sha256"]).get("source")}, pair[1]


def judged_table(
    table: Table, sha256: str | None, setup: Setup, memory: Memory | None = None, **how: Any
) -> tuple[dict[str, Any], Trace]:
    """Judge a table, as ``judged``; where it lacks signals of the model, by tests without one."""
    try:
        opened = RecordingReader(setup.bus_map, setup.model.card).table(table)
    except MissingSignalsError as lacking:
        if not without_model.can_judge(table, lacking):
            raise
        recording = _without_model(table, sha256, setup.config, memory, lacking)
        return recording, without_model.series(table)
    return judged(opened, sha256, setup, memory, **how)


def _without_model(
    table: Table,
    sha256: str | None,
    config: Config,
    memory: Memory | None,
    lacking: MissingSignalsError,
) -> dict[str, Any]:
    store = store_of(memory, config.profile)
    recording = {"path": str(table.path), "sha256": sha256}
    recording |= without_model.judge(table, store, config, lacking)
    if memory:
        memory.save(store.saved)
    return recording | of_memory(memory)


def judged(
    opened: OpenRecording,
    sha256: str | None,
    setup: Setup,
    memory: Memory | None = None,
    *,
    trace: bool = False,
    listeners: Listeners | None = None,
) -> tuple[dict[str, Any], Trace]:
    """Judge an open recording, as ``replay`` judges one on disk.

    sha256 : of its file, None if there is none
    """
    store = store_of(memory, setup.config.profile)
    setup = setup.of_vehicle(memory) if memory else setup
    monitor = SensorMonitor(Judge(opened.names, setup.model, setup.config), setup.limits, store)
    collector = Collector(monitor, sources=opened.sources, trace=trace)
    listen = listeners(monitor) if listeners else None
    for event in _events(monitor, opened):
        collector.push(event)
        if listen:
            listen(event)
        if memory and isinstance(event, CycleStarted):
            memory.learn(setup.model.sha256, event.seen, setup.config.bias)
            monitor.adopt(setup.of_vehicle(memory).limits)
    check_long_enough(opened.path, monitor.samples)
    recording = collector.result(str(opened.path), sha256, opened.counters())
    if memory:
        memory.save(store.saved)
        memory.learn(setup.model.sha256, monitor.decisions.seen, setup.config.bias)
    recording |= of_memory(memory)
    if opened.profile:
        recording |= {"profile": opened.profile}
    if notes := [*opened.notes(), *collector.notes]:
        recording |= {"notes": notes}
    return recording, collector.trace()


def store_of(memory: Memory | None, profile: ProfileConfig) -> DtcStore:
    """Return the fault memory in RAM with a driving cycle begun, empty without one on disk."""
    if memory is not None:
        return memory.begin(profile)
    store = DtcStore(profile=profile)
    store.start_driving_cycle()
    return store


def of_memory(memory: Memory | None) -> dict[str, Any]:
    """Return the entry of the fault memory on disk, if there is one."""
    return {} if memory is None else {"memory": memory.condition.entry}


def _events(monitor: SensorMonitor, opened: OpenRecording) -> Iterator[BlockEvent]:
    for part in opened.parts:
        if opened.is_live():
            monitor.electrical.plausibility.is_expected = True
        if isinstance(part, Clearing):
            yield from monitor.clear(part.t_ns)
            continue
        for block in slices(part, 0, len(part.t_ns)):
            yield from monitor.push(block)


def exit_code(recordings: Sequence[dict[str, Any]]) -> int:
    """Return 1 if a fault was found, else 3 if a recording was not judged, else 0."""
    if any(r["fault_flag"] for r in recordings):
        return 1
    return 3 if any(r["not_judged"] for r in recordings) else 0


def result_of(recordings: list[dict[str, Any]], setup: Setup) -> dict[str, Any]:
    """Return the whole of ``o2mon.replay/1``, with the sources of the verdicts."""
    return {
        "schema": SCHEMA,
        "o2mon_version": __version__,
        "model": {"path": setup.model.path.name, "sha256": setup.model.sha256},
        "recordings": recordings,
    }
