"""A short healthy drive in every format that ``o2mon replay`` reads, to be damaged.

The drive is a stretch of a simulated WLTC in which the test completes: undamaged, each file ends
with exit code 0. CAN logs hold its frames, tables its samples: the project's own columns (CSV,
Parquet) and a logger's (CSV, MSL, MLG), with the units of a tuner and a profile that is found by
its columns in the folder of the logs.
"""

from itertools import takewhile
from pathlib import Path

import numpy as np

from benchmarks.repository import REPLAY_LOGS
from monitor.base.types import FloatArray, Frame
from monitor.frames.blocks import block_of
from monitor.frames.logs import read_frames
from monitor.inject.gateway import write_log
from tests.helpers.logs.logger_files import TUNER_UNITS, Field, write_mlg, write_text_table
from training.recordings.files.mf4_log import write_mf4
from training.recordings.files.table_files import write_table
from training.recordings.recording import Recording, load

DRIVE = REPLAY_LOGS / "healthy_wltc_3b_v101_s101.blf"
BEGIN_S, LENGTH_S = 200.0, 30.0
LOGS = (".log", ".asc", ".csv", ".trc", ".blf", ".mf4")
OWN = (".table.csv", ".parquet")
LOGGERS = (".logger.csv", ".msl", ".mlg")
KINDS = (*LOGS, *OWN, *LOGGERS)
BINARY_KINDS = (".blf", ".mf4", ".parquet", ".mlg")
PROFILE = "tuner.toml"


def write_seeds(folder: Path) -> None:
    """Write the drive in every format as ``seedKIND``, and the logger's profile."""
    frames = stretch(BEGIN_S, LENGTH_S)
    for kind in LOGS:
        if kind == ".mf4":
            write_mf4(folder / "seed.mf4", block_of(frames))
        else:
            write_log(folder / f"seed{kind}", frames)
    drive = load(folder / "seed.log", period_s=0.1)
    held = np.nan_to_num(drive.values, nan=1.0)
    for kind in OWN:
        write_table(folder / f"seed{kind}", drive.t_s, drive.names, held)
    (folder / PROFILE).write_text(_profile(drive))
    fields, columns = _as_logged(drive)
    text, units = {"Time": drive.t_s} | columns, ["s", *(field.unit for field in fields)]
    write_text_table(folder / "seed.logger.csv", text, units=units)
    msl = folder / "seed.msl"
    write_text_table(msl, text, units=units, separator="\t", encoding="latin-1")
    write_mlg(folder / "seed.mlg", fields, np.column_stack(list(columns.values())), drive.t_s)


def stretch(begin_s: float, length_s: float) -> list[Frame]:
    """Return the frames of a stretch of the drive."""
    begin_ns = next(iter(read_frames(DRIVE))).t_ns + round(begin_s * 1e9)
    end_ns = begin_ns + round(length_s * 1e9)
    frames = takewhile(lambda frame: frame.t_ns < end_ns, read_frames(DRIVE))
    return [frame for frame in frames if frame.t_ns >= begin_ns]


def _as_logged(drive: Recording) -> tuple[list[Field], dict[str, FloatArray]]:
    """Return the logger's fields and their columns in its units."""
    fields, columns = [], {}
    for name, values in zip(drive.names, drive.values.T, strict=True):
        column, unit, factor, offset = TUNER_UNITS.get(name, (f"own {name}", "", 1.0, 0.0))
        fields.append(Field(column, unit))
        columns[column] = (np.nan_to_num(values, nan=1.0) - offset) / factor
    return fields, columns


def _profile(drive: Recording) -> str:
    names = (f'{n} = "{TUNER_UNITS.get(n, (f"own {n}",))[0]}"\n' for n in drive.names)
    found_by = '[[recognise]]\ncolumns = ["own lambda_controller", "own fuel_mass_mg"]\n'
    return f'time = ["Time", "MLG timestamp"]\n{found_by}[signals]\n{"".join(names)}'
