"""Model, settings and signal maps for a fleet: as bytes for the worker, and as objects there."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from threading import local
from typing import Any, Final
from weakref import finalize

from monitor.base.config import Config
from monitor.base.files.outputs import write_bytes
from monitor.decode.bus_map import load_pairs
from monitor.grid.tables import checked_columns
from monitor.judge.limits import Limits
from monitor.model.step import Model
from monitor.pipeline.recordings import RecordingReader
from training.fleet import places
from training.jobs import run_folder
from training.jobs.model_bytes import model_of
from training.limits.judging import RecordingJudge
from training.recordings.recording import default_pairs

File = tuple[str, bytes]  # name and content
ROWS: Final = 64  # recordings, or segments of recordings, that run side by side


@dataclass(frozen=True, slots=True)
class WorkerKit:
    """Model, settings, databases and signal maps, as file contents.

    Contents, not paths: a worker on another machine cannot open the files.
    """

    model: File
    config: Config
    pairs: tuple[tuple[File, File], ...]  # pairs of DBC and signal map
    columns: File | None = None  # columns map
    root: Path = Path()  # folder that relative paths of recordings refer to
    channel: str = ""  # of logs that hold several buses

    @classmethod
    def of(
        cls,
        model: Path,
        config: Config,
        pairs: Sequence[tuple[Path, Path]] | None = None,
        columns: Path | None = None,
        channel: str = "",
    ) -> "WorkerKit":
        """Return the kit with the contents of these files.

        pairs : pairs of DBC and signal map; None is the project's ECU
        columns : columns map for tables
        channel : of logs that hold several buses
        Raises ModelError, ConfigError or SignalMapError if a file cannot be used.
        """
        pair_paths = [(Path(a), Path(b)) for a, b in pairs or default_pairs()]
        Limits.from_card(Model.load(model).card, config, str(model))
        load_pairs(pair_paths)
        own = None if columns is None else _file(checked_columns(columns))
        bus = tuple((_file(a), _file(b)) for a, b in pair_paths)
        return cls(_file(model), config, bus, own, Path.cwd(), channel)

    def identity(self) -> dict[str, Any]:
        """Return digests of model, settings, maps and code; equal digests give equal results."""
        bus = (self.pairs, self.channel) if self.channel else self.pairs
        files = {"bus": bus, "columns": self.columns}
        return {
            "model": self.model[0],
            "model_sha256": places.sha256_of(self.model[1]),
            "config_sha256": places.sha256_of(json.dumps(asdict(self.config))),
            **{f"{key}_sha256": places.sha256_of(repr(file)) for key, file in files.items()},
            "code_sha256": run_folder.code_sha256(),
        }


@dataclass(frozen=True, slots=True)
class Tools:
    """The objects that a worker makes from a kit, one set per thread."""

    model: Model
    limits: Limits
    config: Config
    reader: RecordingReader
    columns: Path | None  # columns map, which is read with every table
    folder: "_Folder | None"  # of the columns map
    judges: dict[tuple[str, ...], RecordingJudge] = field(default_factory=dict)

    def judge_for(self, names: tuple[str, ...]) -> RecordingJudge:
        """Return the judge of recordings with these signals, made when it is needed.

        Raises RecordingError if ``names`` lacks an input of the model.
        """
        if names not in self.judges:
            self.judges[names] = RecordingJudge(
                names, self.model, self.limits, self.config, ROWS, keep_banks=False
            )
        return self.judges[names]


def tools_of(kit: WorkerKit) -> Tools:
    """Return the tools of a kit; every thread of a worker makes them once."""
    if getattr(_thread, "kit", None) != kit:
        _thread.tools = _made(kit)
        _thread.kit = kit
    tools: Tools = _thread.tools
    return tools


_thread = local()


class _Folder:
    """A temporary folder that lives as long as this object."""

    def __init__(self) -> None:
        self.path = Path(mkdtemp(prefix="o2-kit-"))
        finalize(self, shutil.rmtree, self.path, ignore_errors=True)


def _made(kit: WorkerKit) -> Tools:
    model, kept = model_of(*kit.model), _Folder() if kit.columns else None
    with TemporaryDirectory(prefix="o2-kit-") as folder:
        laid = [
            (_lay(Path(folder) / f"{i}.dbc", a), _lay(Path(folder) / f"{i}.toml", b))
            for i, (a, b) in enumerate(kit.pairs)
        ]
        bus_map = load_pairs(laid, kit.channel)
    columns = _lay(kept.path, kit.columns) if kept and kit.columns else None
    limits = Limits.from_card(model.card, kit.config, kit.model[0])
    reader = RecordingReader(bus_map, model.card, columns)
    return Tools(model, limits, kit.config, reader, columns, kept)


def _lay(folder: Path, file: File) -> Path:
    """Write a file into ``folder`` and return its path.

    The file keeps its name, because error messages show it.
    """
    folder.mkdir(exist_ok=True)
    path = folder / file[0]
    write_bytes(path, file[1])
    return path


def _file(path: Path) -> File:
    return path.name, path.read_bytes()
