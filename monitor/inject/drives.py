"""The drives of a scenario: a log or table with its faults, written, judged or both."""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from functools import partial
from itertools import chain
from pathlib import Path

from monitor.base.files.manifest import note
from monitor.base.types import Frame
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.log_blocks import keys_of
from monitor.decode.obd_answers import ANSWER, ANSWER_29, POSITIVE, AllParameters
from monitor.frames.blocks import EXTENDED, LogCounters, frames_of
from monitor.frames.channels import Channels
from monitor.frames.logs import read_blocks
from monitor.grid.tables import Table, is_table, origin_of
from monitor.grid.timeline import Timeline
from monitor.inject.expected import Recording
from monitor.inject.gateway import write_log
from monitor.inject.injection import Injection
from monitor.inject.injector import Injector
from monitor.inject.scenario import Scenario
from monitor.inject.table_faults import with_faults, write_own
from monitor.memory.codes import CODES
from monitor.memory.store import Memory
from monitor.pipeline.names import needed_names
from monitor.pipeline.recordings import table_of_model
from monitor.pipeline.replay import Setup, judged_table, replay

Place = Callable[[int], Path | None]


def play(
    recording: Path,
    scenario: Scenario,
    setup: Setup,
    *,
    judges: bool = True,
    place: Place = lambda _: None,
    say: Callable[[str], None] = lambda _: None,
) -> list[Recording]:
    """Play a log or table once for each drive of a scenario; return the entries of the judged ones.

    judges : whether the monitor judges the drives, with one fault memory
    place : gives the file to write for the number of a drive, None for none
    say : takes lines about what was changed
    Raises O2Error if the recording cannot be read, written or judged, or a fault is not for it.
    """
    with (
        tempfile.TemporaryDirectory(prefix="o2mon-") as folder,
        closing(Memory(Path(folder, "memory.db"))) as memory,
    ):
        if is_table(recording):
            table = table_of_model(recording, setup.columns, setup.model.card)
            drive_of = partial(_table_drive, table)
        else:
            drive_of = partial(_log_drive, recording, Path(folder, f"{recording.name}.log"))
        entries = [
            drive_of(scenario, drive, setup, memory if judges else None, place(drive), say)
            for drive in range(1, scenario.n_drives + 1)
        ]
    return [entry for entry in entries if entry is not None]


def _log_drive(
    log: Path,
    fleeting: Path,
    scenario: Scenario,
    drive: int,
    setup: Setup,
    memory: Memory | None,
    out: Path | None,
    say: Callable[[str], None],
) -> Recording | None:
    injector = Injector(
        setup.bus_map,
        scenario.faults_of(drive),
        seed=scenario.seed_of(drive),
        keep_counters=scenario.keep_counters,
    )
    names = needed_names(setup.model.card, (*setup.bus_map.names, *setup.bus_map.optional))
    found, timeline = LogCounters(), Timeline(BlockDecoder(setup.bus_map, names))
    mapped = keys_of(channel.message for channel in setup.bus_map.channels.values())
    blocks = read_blocks(log, found, Channels(setup.bus_map.log_channel, mapped))
    is_polled = ANSWER in mapped
    blocks = timeline.blocks(map(AllParameters().push, blocks) if is_polled else blocks)
    read = chain.from_iterable(map(frames_of, blocks))
    frames = injector.stream(_alone(read, injector.counts.kept) if is_polled else read)
    written = out or fleeting
    write_log(written, frames, setup.bus_map.log_channel)
    if out:
        _note(out, log, scenario.faults_of(drive))
    entry = replay(written, setup, memory)[0] if memory else None
    counts = injector.counts
    counts.kept.update(timeline.counters.found | {"error and remote frames": found.skipped})
    for line in (*counts.lines(), *found.notes):
        say(f"{out or log}: {line}")
    return entry and {**entry, "path": str(out or log), "n_changed": counts.changed.total()}


def _alone(frames: Iterable[Frame], counts: Counter[str]) -> Iterator[Frame]:
    """Leave out the OBD answers of several frames; each of their parameters has a frame beside."""
    several = set[tuple[int, bool]]()
    for frame in frames:
        ecu, data = frame[1:3], frame.data
        if ecu == (ANSWER, False) or (ecu[1] and ecu[0] & ~0xFF | EXTENDED == ANSWER_29):
            kind = data[0] >> 4 if data else -1
            if kind == 1 and data[2:3] == bytes([POSITIVE]):
                several.add(ecu)
            elif kind != 2:
                several.discard(ecu)
            if ecu in several:
                counts["frames of answers taken apart"] += 1
                continue
        yield frame


def _table_drive(
    table: Table,
    scenario: Scenario,
    drive: int,
    setup: Setup,
    memory: Memory | None,
    out: Path | None,
    say: Callable[[str], None],
) -> Recording | None:
    changed, n = with_faults(table, scenario.faults_of(drive), scenario.seed_of(drive))
    if out:
        write_own(out, changed)
        _note(out, table.path, scenario.faults_of(drive), **origin_of(table))
    say(f"{out or table.path}: lambda changed in {n} of {len(changed.t_ns)} rows")
    if memory is None:
        return None
    return judged_table(changed, None, setup, memory)[0] | {"n_changed": n}


def _note(out: Path, origin: Path, faults: Sequence[Injection], **more: object) -> None:
    """Name a written drive in the manifest beside it, with the first fault that has a code."""
    first = next((each for each in faults if each.name in CODES), None)
    said = {"fault": first.name, "severity": first.severity, "in_the_loop": False} if first else {}
    note(out, origin, **said, **more)
