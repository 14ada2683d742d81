"""Parameters that commands of ``o2mon`` and ``o2train`` share, written once."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.option_kinds import BUS, LOG, TABLE, ActsOn
from monitor.base.command_line.signature import REPEATED
from monitor.base.errors import UsageError

Input = Annotated[Path, paths.read]
Output = Annotated[Path | None, paths.written, "OUT"]
Recordings = Annotated[Sequence[Path], paths.recording, "RECORDING"]
Quiet = Annotated[bool, "-q", "--quiet"]
Number = Annotated[int, "N"]
OF_FRAMES: Final = ActsOn([LOG, BUS])


@dataclass(frozen=True, kw_only=True)
class BusFiles:
    """Which frames of a log are which signals.

    dbc : CAN database (.dbc); repeat it with --map for several databases (default: the project's
        own ECU)
    map : signal map (.toml) of the --dbc before it; repeat it with --dbc
    """

    dbc: Annotated[Sequence[Path], paths.read, REPEATED, OF_FRAMES, "FILE"] = ()
    map: Annotated[Sequence[Path], paths.read, REPEATED, OF_FRAMES, "FILE"] = ()

    @property
    def pairs(self) -> list[tuple[Path, Path]]:
        """Return the pairs of database and map; raises UsageError if one has no partner."""
        if len(self.dbc) != len(self.map):
            raise UsageError(
                f"--dbc and --map come in pairs: {len(self.dbc)} --dbc, {len(self.map)} --map"
            )
        return list(zip(self.dbc, self.map, strict=True))


@dataclass(frozen=True, kw_only=True)
class LogChannel:
    """Which frames of a log are read.

    channel : of a log that holds several buses, the one that is meant
    """

    channel: Annotated[str, OF_FRAMES, "NAME"] = ""


@dataclass(frozen=True, kw_only=True)
class ColumnNames:
    """Which column of a table is which signal.

    columns : TOML file that says which column of a table or measurement file is which signal, or a
        shipped profile's name (default: the profile of a logger's file is recognised)
    """

    columns: Annotated[
        Path | None, paths.read, ActsOn([TABLE]), "--profile", "--columns", "NAME|FILE"
    ] = None


def reading_words(
    kinds: Collection[str], pairs: Sequence[tuple[Path, Path]], columns: Path | None, channel: str
) -> list[str]:
    """Return the options that say how recordings of these kinds are read, for another command."""
    words = ["--profile", str(columns)] if columns and TABLE in kinds else []
    if LOG in kinds:
        words += [str(word) for dbc, map in pairs for word in ("--dbc", dbc, "--map", map)]
        words += ["--channel", channel] if channel else []
    return words


@dataclass(frozen=True, kw_only=True)
class SettingsFile:
    """What changes the shipped settings.

    config : TOML file that changes the shipped settings
    """

    config: Input | None = None
