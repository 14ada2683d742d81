"""Which recordings a fleet has, whose they are, and which are judged together."""

import csv
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

from monitor.base import manifest
from monitor.base.errors import RecordingError, UsageError
from training.fleet import places

SIDE_BY_SIDE: Final = 32  # vehicles of a chunk
LEAST_SIDE: Final = 4  # of a small fleet, so that its chunks occupy several cores
DRIVES: Final = 512  # of a chunk, unless one vehicle has more


@dataclass(frozen=True, slots=True)
class Drive:
    """One recording of a fleet."""

    recording: int  # its number in the order in which the recordings are given
    path: str  # or URL
    vehicle: str
    drive: int  # of this vehicle, from 0
    declared: tuple[str, str] | None = None  # sha256 and source in the manifest beside it
    is_alone: bool = False  # nobody says whose it is: nothing is learned from it


@dataclass(frozen=True, slots=True)
class Chunk:
    """Vehicles that are judged together: of each the first drive, then the second, and so on."""

    name: str
    vehicles: tuple[tuple[Drive, ...], ...]

    @property
    def drives(self) -> int:
        """Return the number of drives."""
        return sum(map(len, self.vehicles))

    def rounds(self) -> Iterator[list[Drive]]:
        """Yield the first drive of every vehicle, then the second."""
        for i in range(max(map(len, self.vehicles))):
            yield [own[i] for own in self.vehicles if i < len(own)]


def drives_of(
    given: Sequence[str], pattern: str | None = None, besides: Sequence[Path] = ()
) -> list[Drive]:
    """Return the recordings that files, folders, patterns and manifests stand for.

    given : a ``.csv`` file with a column ``path`` is a manifest
    pattern : regular expression whose first group names the vehicle in a path
    besides : files, and folders with what is in them, that are no recordings wherever they lie
    Vehicles of the manifest, or of the pattern, are those of their drives in the order given; any
    other recording is a vehicle of its own, named like its file.
    Raises UsageError naming what is wrong, also for a recording that is there twice.
    """
    others = tuple(str(path.absolute()) for path in besides)
    inside = tuple(f"{path}/" for path in others)
    found: dict[str, str] = {}
    known = set[str]()
    for path, vehicle in chain.from_iterable(map(_listed, given)):
        place = str(Path(path).absolute()) if places.is_local(path) else path
        if place in others or place.startswith(inside):
            continue
        if place in known:
            raise UsageError(f"{path}: is there twice")
        known.add(place)
        found[path] = vehicle or _named(path, pattern)
    if not found:
        raise UsageError(f"{', '.join(given)}: no recording there but what the run itself writes")
    names = Counter(vehicle or places.name_of(path) for path, vehicle in found.items())
    declared = _Declared()
    count: dict[str, int] = {}
    drives = []
    for number, (path, named) in enumerate(found.items()):
        name = places.name_of(path)
        vehicle = named or (name if names[name] == 1 else path)
        own = count.setdefault(vehicle, 0)
        drives.append(Drive(number, path, vehicle, own, declared.of(path), not named))
        count[vehicle] += 1
    return drives


def chunks_of(drives: Iterable[Drive]) -> list[Chunk]:
    """Return the chunks, vehicles in the order in which they appear first."""
    vehicles: dict[str, list[Drive]] = {}
    for drive in drives:
        vehicles.setdefault(drive.vehicle, []).append(drive)
    most = min(max(len(vehicles) // 8, LEAST_SIDE), SIDE_BY_SIDE)
    groups: list[list[tuple[Drive, ...]]] = [[]]
    for own in vehicles.values():
        held = sum(map(len, groups[-1]))
        if groups[-1] and (len(groups[-1]) == most or held + len(own) > DRIVES):
            groups.append([])
        groups[-1].append(tuple(own))
    return [Chunk(f"chunk_{i:06d}", tuple(group)) for i, group in enumerate(groups)]


def digest(drives: Sequence[Drive]) -> str:
    """Return the sha256 of all that says which recordings there are and whose."""
    lines = (json.dumps([d.path, d.vehicle, d.declared]) for d in drives)
    return places.sha256_of("\n".join(lines))


def _listed(given: str) -> list[tuple[str, str]]:
    """Return paths and vehicles, "" where nothing is said."""
    if places.name_of(given).lower().endswith(".csv") and not places.is_pattern(given):
        if places.is_local(given):
            places.find(given)  # that it is there
        text = places.read_text(given).lstrip("\ufeff")
        header = next(csv.reader(text.splitlines()[:1], skipinitialspace=True), [])
        if "path" in (name.strip() for name in header):
            return _manifest(given, text)
    return [(path, "") for path in places.find(given)]


def _manifest(url: str, text: str) -> list[tuple[str, str]]:
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True)
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
        if None in row:  # where DictReader puts what is too much
            raise UsageError(
                f"{url}: line {reader.line_num}: more than {' and '.join(reader.fieldnames)}; a "
                "comma within one wants quotes"
            )
        rows.append((places.joined(folder, path), vehicle))
    if not rows:
        raise UsageError(f"{url}: the manifest has no recording")
    return rows


def _named(path: str, pattern: str | None) -> str:
    """Return the vehicle that the pattern finds in a path, "" if none."""
    if pattern is None:
        return ""
    try:
        match = re.search(pattern, path)
        return (match[1] or "") if match else ""
    except (re.error, IndexError) as error:
        raise UsageError(
            f"--vehicle {pattern}: {error}; wanted a regular expression with one group"
        ) from None


class _Declared:
    """What the manifests beside recordings say of them, each read once."""

    def __init__(self) -> None:
        self._entries: dict[str, dict[str, dict[str, Any]]] = {}

    def of(self, path: str) -> tuple[str, str] | None:
        """Return sha256 and source of a recording, None if nothing is said."""
        folder = places.folder_of(path)
        if folder not in self._entries:
            self._entries[folder] = _entries(folder)
        entry = self._entries[folder].get(places.name_of(path), {})
        sha256, source = entry.get("sha256"), entry.get("source")
        return (str(sha256), str(source)) if sha256 and source else None


def _entries(folder: str) -> dict[str, dict[str, Any]]:
    try:
        with places.fetched(f"{folder}/{manifest.NAME}") as path:
            return manifest.load(path.parent)
    except RecordingError:  # elsewhere: there is none
        return {}
