"""One chunk of a fleet: every recording read and judged, those of many vehicles side by side.

A vehicle's drives share its fault memory and its reference, in their order, as with
``o2mon replay --memory``. What cannot be read or judged is a row with its reason.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from monitor.base.errors import O2Error
from monitor.memory.dtc import DtcStore, Saved
from monitor.memory.reference import Reference
from training.fleet import places
from training.fleet.bench import Bench, Tools, tools_of
from training.fleet.chunk_rows import Done, of_rows
from training.fleet.drives import Chunk, Drive
from training.fleet.reading import Read
from training.fleet.rows import Row, failed_row, recording_row, window_rows

SAMPLES = 400_000  # held side by side; their windows take some megabytes per ten thousand


@dataclass(slots=True)
class _Vehicle:
    """What one drive leaves to the next."""

    saved: Saved | None = None
    reference: Reference = field(default_factory=Reference)


@dataclass(slots=True)
class _Work:
    """A chunk under way."""

    bench: Bench
    tools: Tools
    vehicles: dict[str, _Vehicle]
    recordings: list[Row] = field(default_factory=list)
    windows: list[Row] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=lambda: {"read": 0.0, "judge": 0.0})


def judge_chunk(bench: Bench, chunk: Chunk) -> Done:
    """Return the rows of a chunk, in the order of its vehicles and their drives."""
    tools = tools_of(bench)
    names = [own[0].vehicle for own in chunk.vehicles]
    work = _Work(bench, tools, {name: _Vehicle() for name in names})
    for drives in chunk.rounds():
        held: list[tuple[Drive, Read]] = []
        for drive in drives:
            read = _read(work, drive)
            if read is not None:
                held.append((drive, read))
            if sum(len(each.block.t_ns) for _, each in held) >= SAMPLES:
                _judge(work, held)
                held = []
        _judge(work, held)
    return _done(work, names)


def _read(work: _Work, drive: Drive) -> Read | None:
    """Return a recording's samples, None if it cannot be read; it then has its row."""
    began_s = time.process_time()
    try:
        with places.fetched(drive.path, work.bench.root) as path:
            return _read_file(path, drive, work.tools)
    except O2Error as error:
        work.recordings.append(failed_row(drive, str(error)))
    except Exception as error:  # no file may stop a fleet
        reason = f"{drive.path}: internal error: {type(error).__name__}: {error}"
        work.recordings.append(failed_row(drive, reason))
    finally:
        work.seconds["read"] += time.process_time() - began_s
    return None


def _read_file(path: Path, drive: Drive, tools: Tools) -> Read:
    try:
        return tools.reader.read(path)
    except O2Error as error:
        raise type(error)(str(error).replace(str(path), drive.path)) from error


def _judge(work: _Work, held: Sequence[tuple[Drive, Read]]) -> None:
    """Judge recordings of different vehicles; those with the same signals side by side."""
    began_s = time.process_time()
    alike: dict[tuple[bool, tuple[str, ...]], list[tuple[Drive, Read]]] = {}
    for drive, read in held:
        alike.setdefault((drive.is_alone, read.names), []).append((drive, read))
    for group in alike.values():
        try:
            _judge_alike(work, group)
        except Exception:  # which one it is shows when each is judged alone
            for each in group:
                _judge_alone(work, each)
    work.seconds["judge"] += time.process_time() - began_s


def _judge_alone(work: _Work, one: tuple[Drive, Read]) -> None:
    drive = one[0]
    try:
        _judge_alike(work, [one])
    except O2Error as error:
        work.recordings.append(failed_row(drive, f"{drive.path}: {error}"))
    except Exception as error:
        reason = f"{drive.path}: internal error: {type(error).__name__}: {error}"
        work.recordings.append(failed_row(drive, reason))


def _judge_alike(work: _Work, group: Sequence[tuple[Drive, Read]]) -> None:
    """Judge recordings with the same signals; either all of them get their rows or none."""
    config, tools = work.bench.config, work.tools
    is_alone, names = group[0][0].is_alone, group[0][1].names
    known = [work.vehicles[drive.vehicle] for drive, _ in group]
    stores = [DtcStore(each.saved, config.profile) for each in known]
    for store in stores:
        store.start_driving_cycle()
    judged = tools.judge_for(names).judge(
        [read.block for _, read in group],
        stores,
        None if is_alone else [each.reference for each in known],
        [read.clearings for _, read in group],
    )
    card, found = tools.model.card, []
    for (drive, read), vehicle, each in zip(group, known, judged, strict=True):
        row = recording_row(drive, read, each, card, vehicle.reference.drives)
        found.append((row, window_rows(drive, read, each)))
    for (row, windows), vehicle, store, each in zip(found, known, stores, judged, strict=True):
        work.recordings.append(row)
        work.windows += windows
        vehicle.saved, vehicle.reference = store.saved, each.reference
        if each.seen is not None:
            vehicle.reference = each.reference.learn(each.seen, config.bias)


def _done(work: _Work, names: Sequence[str]) -> Done:
    place = {name: i for i, name in enumerate(names)}

    def order(row: Row) -> tuple[int, int]:
        return place[row["vehicle"]], row["drive"]

    rows, windows = sorted(work.recordings, key=order), sorted(work.windows, key=order)
    return of_rows(rows, windows, work.seconds)
