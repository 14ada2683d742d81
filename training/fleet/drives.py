"""Drives of a fleet: their recordings, vehicles and chunks."""

import csv
import io
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import RecordingError, UsageError
from monitor.base.files import manifest
from training.fleet import places

SIDE_BY_SIDE: Final = 32  # most vehicles of a chunk
LEAST_SIDE: Final = 4  # most vehicles of a chunk in a small fleet, so that several cores work
DRIVES: Final = 512  # most drives of a chunk; a vehicle with more drives is one chunk


@dataclass(frozen=True, slots=True)
class FleetDrive:
    """One recording of a fleet."""

    recording: int  # number of the recording in the order of the command, from 0
    path: str  # path or URL
    vehicle: str
    drive: int  # number among the drives of its vehicle, from 0
    declared: tuple[str, str] | None = None  # sha256 and source in the manifest.json beside it
    is_alone: bool = False  # the vehicle is unknown, so no reference learns from the drive
    copy_of: str | None = None  # path of an earlier recording with the same content, which counts


@dataclass(frozen=True, slots=True)
class Chunk:
    """Vehicles that are judged together: first their first drives, then their second drives."""

    name: str
    vehicles: tuple[tuple[FleetDrive, ...], ...]

    @property
    def drives(self) -> int:
        """Return the number of drives."""
        return sum(map(len, self.vehicles))

    def rounds(self) -> Iterator[list[FleetDrive]]:
        """Yield the first drives of all vehicles, then their second drives, and so on."""
        for i in range(max(map(len, self.vehicles))):
            yield [drives[i] for drives in self.vehicles if i < len(drives)]


def drives_of(
    given: Sequence[str], pattern: str | None = None, besides: Sequence[Path] = ()
) -> list[FleetDrive]:
    """Return the drives behind files, folders, patterns and manifests.

    given : paths or URLs; a ``.csv`` file with a column ``path`` is a manifest
    pattern : regular expression whose first group names the vehicle in a path
    besides : files and folders that hold no recordings, for example the output of the run
    A recording without a vehicle in the manifest or by the pattern is a vehicle alone, named after
    its file. The drives of a vehicle keep their order.
    Raises UsageError if there is no recording, a recording is listed twice, or a manifest, path or
    pattern is wrong.
    """
    excluded = [path.resolve() for path in besides]
    vehicle_of: dict[str, str] = {}
    seen = set[str]()
    for path, vehicle in chain.from_iterable(map(_listed, given)):
        place = str(Path(path).absolute()) if places.is_local(path) else path
        if places.is_local(path) and any(map(Path(path).resolve().is_relative_to, excluded)):
            continue
        if place in seen:
            raise UsageError(f"{path}: is there twice")
        seen.add(place)
        vehicle_of[path] = vehicle or _named(path, pattern)
    if not vehicle_of:
        raise UsageError(f"{', '.join(given)}: no recording there but what the run itself writes")
    if pattern and not any(vehicle_of.values()):
        raise UsageError(f"--vehicle {pattern}: matches no path, as {path}")
    names = Counter(vehicle or places.name_of(path) for path, vehicle in vehicle_of.items())
    entries_of, copies = cache(_entries), _copies(vehicle_of)  # each manifest.json is read once
    count, drives = Counter[str](), []
    for number, (path, named) in enumerate(vehicle_of.items()):
        name = places.name_of(path)
        vehicle = named or (name if names[name] == 1 else path)
        declared = _declared(entries_of(places.folder_of(path)).get(name, {}))
        place_of = number, path, vehicle, count[vehicle], declared
        drives.append(FleetDrive(*place_of, is_alone=not named, copy_of=copies.get(path)))
        count[vehicle] += 1
    return drives


def chunks_of(drives: Iterable[FleetDrive]) -> list[Chunk]:
    """Return the chunks; the vehicles keep the order of their first drives."""
    vehicles: dict[str, list[FleetDrive]] = {}
    for drive in drives:
        vehicles.setdefault(drive.vehicle, []).append(drive)
    most = min(max(len(vehicles) // 8, LEAST_SIDE), SIDE_BY_SIDE)
    groups: list[list[tuple[FleetDrive, ...]]] = [[]]
    for of_vehicle in vehicles.values():
        held = sum(map(len, groups[-1]))
        if groups[-1] and (len(groups[-1]) == most or held + len(of_vehicle) > DRIVES):
            groups.append([])
        groups[-1].append(tuple(of_vehicle))
    return [Chunk(f"chunk_{i:06d}", tuple(group)) for i, group in enumerate(groups)]


def digest(drives: Sequence[FleetDrive]) -> str:
    """Return the sha256 of paths, vehicles, declared digests and local sizes of all drives."""
    lines = (json.dumps([d.path, d.vehicle, d.declared, _size_of(d.path)]) for d in drives)
    return places.sha256_of("\n".join(lines))


def _copies(paths: Iterable[str]) -> dict[str, str]:
    """Return the files of this machine with the content of an earlier one, and that one.

    Only files of equal size are read.
    """
    by_size: dict[int, list[str]] = {}
    for path in paths:
        by_size.setdefault(_size_of(path), []).append(path)
    alike = (path for size, group in by_size.items() if size and len(group) > 1 for path in group)
    first: dict[str, str] = {}
    copies = {}
    for path in alike:
        with suppress(OSError):
            earlier = first.setdefault(manifest.sha256_of(Path(path)), path)
            if earlier != path:
                copies[path] = earlier
    return copies


def _size_of(path: str) -> int:
    """Return the bytes of a file of this machine, 0 for one elsewhere or none."""
    with suppress(OSError):
        return Path(path).stat().st_size if places.is_local(path) else 0
    return 0


def _listed(given: str) -> list[tuple[str, str]]:
    """Return pairs of path and vehicle; the vehicle is "" without a manifest."""
    found = places.find(given)
    if found == [given] and places.name_of(given).lower().endswith(".csv"):
        text = places.read_text(given).lstrip("\ufeff")
        head = text.splitlines()[:1]
        delimiter = next((each for each in ";\t" if each in "".join(head)), ",")
        header = next(csv.reader(head, delimiter=delimiter, skipinitialspace=True), [])
        if "path" in (name.strip() for name in header):
            return _manifest(given, text, delimiter)
    return [(path, "") for path in found]


def _manifest(url: str, text: str, delimiter: str) -> list[tuple[str, str]]:
    lines = io.StringIO(text, newline=None)
    reader = csv.DictReader(lines, delimiter=delimiter, skipinitialspace=True)
    reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
    unknown = [name for name in reader.fieldnames if name not in ("path", "vehicle")]
    if unknown:
        raise UsageError(f"{url}: unknown column {unknown[0]!r}, wanted path and vehicle")
    folder = places.folder_of(url)
    rows = []
    for row in reader:
        path, vehicle = ((row.get(key) or "").strip() for key in ("path", "vehicle"))
        if not path:
            raise UsageError(f"{url}: line {reader.line_num}: no path")
        if None in row:  # DictReader stores surplus cells under None
            raise UsageError(
                f"{url}: line {reader.line_num}: more than {' and '.join(reader.fieldnames)}; a "
                "comma within one wants quotes"
            )
        rows.append((places.joined(folder, path), vehicle))
    if not rows:
        raise UsageError(f"{url}: the manifest has no recording")
    return rows


def _named(path: str, pattern: str | None) -> str:
    """Return the vehicle that the pattern matches in a path, "" without a match."""
    if pattern is None:
        return ""
    try:
        match = re.search(pattern, path)
        return (match[1] or "") if match else ""
    except (re.error, IndexError) as error:
        raise UsageError(
            f"--vehicle {pattern}: {error}; wanted a regular expression with one group"
        ) from None


def _declared(entry: dict[str, Any]) -> tuple[str, str] | None:
    """Return the sha256 and source that an entry of a manifest.json declares, None without."""
    sha256, source = entry.get("sha256"), entry.get("source")
    return (str(sha256), str(source)) if sha256 and source else None


def _entries(folder: str) -> dict[str, dict[str, Any]]:
    try:
        with places.fetched(f"{folder}/{manifest.NAME}") as path:
            return manifest.load(path.parent)
    except RecordingError:  # a remote folder without a manifest.json
        return {}
