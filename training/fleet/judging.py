"""Judge one chunk of a fleet: read its recordings and judge many vehicles side by side.

The drives of a vehicle share its fault memory and its reference, in their order, as with
``o2mon replay --memory``. A recording that cannot be read or judged gives a row with the reason.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from monitor.base.errors import O2Error
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.reference import Reference
from training.fleet import places
from training.fleet.chunk_rows import Done, of_rows
from training.fleet.drives import Chunk, FleetDrive
from training.fleet.reading import Read, samples_of
from training.fleet.rows import Row, failed_row, recording_row, window_rows
from training.fleet.worker_kit import Tools, WorkerKit, tools_of

SAMPLES = 400_000  # read before judging; 10,000 samples need some megabytes for their windows


@dataclass(slots=True)
class _Vehicle:
    """Fault memory and reference that one drive of a vehicle leaves to the next."""

    saved: Saved | None = None
    reference: Reference = field(default_factory=Reference)


@dataclass(slots=True)
class _Work:
    """State of a chunk while it is judged."""

    kit: WorkerKit
    tools: Tools
    vehicles: dict[str, _Vehicle]
    recordings: list[Row] = field(default_factory=list)
    windows: list[Row] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=lambda: {"read": 0.0, "judge": 0.0})


def judge_chunk(kit: WorkerKit, chunk: Chunk) -> Done:
    """Return the rows of a chunk in the order of its vehicles and their drives.

    No recording raises: a recording that cannot be read or judged gives a row with an error.
    """
    work = _Work(kit, tools_of(kit), {drives[0].vehicle: _Vehicle() for drives in chunk.vehicles})
    for drives in chunk.rounds():
        held: list[tuple[FleetDrive, Read]] = []
        for drive in drives:
            if (read := _read(work, drive)) is not None:
                held.append((drive, read))
            if sum(len(samples.block.t_ns) for _, samples in held) >= SAMPLES:
                _judge(work, held)
                held = []
        _judge(work, held)
    place = {name: i for i, name in enumerate(work.vehicles)}
    rows, windows = (
        sorted(each, key=lambda row: (place[row["vehicle"]], row["drive"]))
        for each in (work.recordings, work.windows)
    )
    return of_rows(rows, windows, work.seconds)


def _read(work: _Work, drive: FleetDrive) -> Read | None:
    """Return the samples of a recording.

    If the recording is a copy or cannot be read, add its row with the error to ``work`` and return
    None.
    """
    if drive.copy_of:
        reason = f"{drive.path}: the same content as {drive.copy_of}, which counts"
        work.recordings.append(failed_row(drive, reason))
        return None
    began_s, local = time.process_time(), drive.path
    try:
        with places.fetched(drive.path, work.kit.root) as path:
            local = str(path)
            return samples_of(path, work.tools)
    except Exception as error:  # a bad file must not stop the fleet
        known = str(error).replace(local, drive.path)
        reason = known if isinstance(error, O2Error) else _internal(drive, error)
        work.recordings.append(failed_row(drive, reason))
    finally:
        work.seconds["read"] += time.process_time() - began_s
    return None


def _judge(work: _Work, held: Sequence[tuple[FleetDrive, Read]]) -> None:
    """Judge recordings of different vehicles; recordings with equal signals run side by side."""
    began_s = time.process_time()
    alike: dict[tuple[bool, tuple[str, ...]], list[tuple[FleetDrive, Read]]] = {}
    for drive, read in held:
        alike.setdefault((drive.is_alone, read.names), []).append((drive, read))
    for group in alike.values():
        try:
            _judge_alike(work, group)
        except Exception:  # judge the recordings one by one to find the bad recording
            for one in group:
                _judge_alone(work, one)
    work.seconds["judge"] += time.process_time() - began_s


def _judge_alone(work: _Work, one: tuple[FleetDrive, Read]) -> None:
    drive = one[0]
    try:
        _judge_alike(work, [one])
    except Exception as error:
        is_known = isinstance(error, O2Error)
        reason = f"{drive.path}: {error}" if is_known else _internal(drive, error)
        work.recordings.append(failed_row(drive, reason))


def _internal(drive: FleetDrive, error: Exception) -> str:
    return f"{drive.path}: internal error: {type(error).__name__}: {error}"


def _judge_alike(work: _Work, group: Sequence[tuple[FleetDrive, Read]]) -> None:
    """Judge recordings with equal signals; add the rows of all recordings or, on error, none."""
    config, tools = work.kit.config, work.tools
    is_alone, names = group[0][0].is_alone, group[0][1].names
    vehicles = [work.vehicles[drive.vehicle] for drive, _ in group]
    stores = [DtcStore(vehicle.saved, config.profile) for vehicle in vehicles]
    for store in stores:
        store.start_driving_cycle()
    judged = tools.judge_for(names).judge(
        [read.block for _, read in group],
        stores,
        None if is_alone else [vehicle.reference for vehicle in vehicles],
        [read.clearings for _, read in group],
    )
    card, rows = tools.model.card, []
    for (drive, read), vehicle, result in zip(group, vehicles, judged, strict=True):
        row = recording_row(drive, read, result, card, vehicle.reference.drives)
        rows.append((row, window_rows(drive, read, result)))
    for (row, windows), vehicle, store, result in zip(rows, vehicles, stores, judged, strict=True):
        work.recordings.append(row)
        work.windows += windows
        vehicle.saved, vehicle.reference = store.saved, result.reference
        if result.seen is not None:
            vehicle.reference = result.reference.learn(result.seen, config.bias)
