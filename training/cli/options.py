"""Options that the commands of ``o2train`` share, and the reading of recordings with them."""

import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import (
    BusFiles,
    ColumnNames,
    LogChannel,
    Number,
    Recordings,
)
from monitor.base.errors import UsageError

if TYPE_CHECKING:
    from monitor.model.card import ModelCard
    from training.recordings.recording import Recording

FORMATS: Final = (
    "CAN logs (.log .asc .blf .trc .csv .mf4), tables (.csv .parquet), logs of tuning tools (.msl "
    ".mlg .csv) or measurement files (.dat .mdf .mf4); logs and tables of text also with .gz"
)
ModelPath = Annotated[Path, paths.read, "MODEL.onnx"]
NewModel = Annotated[Path, paths.written_model, "MODEL.onnx"]
Folder = Annotated[Path, paths.folder, "DIR"]
Page = Annotated[Path | None, paths.written, "HTML"]
Minutes = Annotated[float, "MIN"]
Length = Annotated[float, "S"]
Names = Annotated[Sequence[str], "NAME"]
SomeRecordings = Annotated[Recordings, {"help": FORMATS}]


@dataclass(frozen=True, kw_only=True)
class ReadOptions(BusFiles, ColumnNames, LogChannel):
    """How recordings are read."""


@dataclass(frozen=True, kw_only=True)
class GridOptions(ReadOptions):
    """How recordings are read on a grid.

    period : period of the sample grid in seconds (default: 0.1 for logs, the period of the rows for
        tables, the period of the model if there is one)
    """

    period: Length | None = None


@dataclass(frozen=True, kw_only=True)
class SignalOptions:
    """Signals of a model.

    inputs : input signals of the model (default: the seven inputs of the paper where all recordings
        have them, otherwise chosen from what they have)
    output : signal that the model predicts (default: lambda_measured)
    """

    inputs: Names | None = None
    output: Annotated[str | None, "NAME"] = None


@dataclass(frozen=True, kw_only=True)
class SeedOption:
    """Where chance begins.

    seed : seed of the initial weights and of the held-out blocks
    """

    seed: Number = 0


@dataclass(frozen=True, kw_only=True)
class CoreOptions:
    """Where jobs run.

    jobs : number of processes on this machine (default: one per core)
    scheduler : run the jobs on the Dask cluster of this scheduler, for example tcp://host:8786
    """

    jobs: Number | None = None
    scheduler: Annotated[str | None, "URL"] = None

    @property
    def n_jobs(self) -> int:
        """Return the number of processes; raises UsageError if it is below 1."""
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"--jobs is at least 1, not {self.jobs}")
        return self.jobs or os.cpu_count() or 1


def load_all(
    args: ReadOptions,
    given: Sequence[Path],
    period_s: float | None,
    card: "ModelCard | None" = None,
    *,
    one_grid: bool = False,
) -> "list[Recording]":
    """Return recordings, read with these options, and print how the files of loggers were read.

    period_s, one_grid : as in ``load_recordings``
    card : of the model whose profile reads a logger's file
    Raises RecordingError or UsageError; the message names the file and the reason.
    """
    from training.api.recordings import load_recordings

    found = load_recordings(
        list(given),
        period_s=period_s,
        buses=args.pairs or None,
        channel=args.channel,
        columns=args.columns,
        of_model=card.profile if card else None,
        one_grid=one_grid,
    )
    tell_notes(found)
    return found


def inputs_of(args: SignalOptions, recordings: "Sequence[Recording]") -> tuple[str, ...]:
    """Return the inputs of ``--inputs``, else those chosen from the recordings' signals.

    Raises RecordingError if there are none.
    """
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from training.recordings.samples.input_choice import choose_inputs, in_words

    if args.inputs:
        return tuple(args.inputs)
    chosen = choose_inputs(recordings, args.output or OUTPUT)
    if chosen != NARX_INPUTS:
        print(in_words(chosen))
    return chosen


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on the standard error."""
    for each in warnings:
        print(f"o2train: warning: {each}", file=sys.stderr)


def tell_notes(recordings: "list[Recording]") -> None:
    """Print how the files of loggers were read."""
    for each in recordings:
        for note in each.notes:
            print(f"o2train: {each.path}: {note}", file=sys.stderr)
