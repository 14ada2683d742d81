"""Columns of the two tables of a fleet, with types, units and descriptions.

docs/reference/fleet_tables.md repeats the descriptions; a test compares them.
"""

from typing import Final

import polars as pl

from monitor.judge.enable import CONDITIONS

Columns = dict[str, tuple[pl.DataType, str]]
_NUMBER: Final = pl.Float64()
_TEXT: Final = pl.String()
_TEXTS: Final = pl.List(_TEXT)

WHICH: Final[Columns] = {
    "recording": (pl.UInt32(), "number of the recording in the order of the command, from 0"),
    "path": (_TEXT, "path or URL of the recording"),
    "vehicle": (_TEXT, "vehicle by the manifest or --vehicle, otherwise the file name"),
    "drive": (pl.UInt32(), "number of the drive among the drives of its vehicle, from 0"),
}

_START: Final[Columns] = {
    "start": (
        pl.Datetime("us", "UTC"),
        "time of the first sample, UTC, or the date in the file's name; null without either",
    )
}

ESTIMATES: Final[Columns] = {
    f"{what}_{edge}{kind}_s": (
        _NUMBER,
        f"{'standard deviation of the' if kind else 'estimated'} {text} on "
        f"{edge.replace('_', ' ')} edges, s",
    )
    for what, text in (("lag", "lag"), ("dead_time", "dead time"))
    for edge in ("rich_to_lean", "lean_to_rich")
    for kind in ("", "_std")
}

# column → key of the monitor's entry, type, description
_BEHIND: Final = {
    "catalyst_capacity_g": ("capacity_g", _NUMBER, "estimated oxygen storage of the catalyst, g"),
    "catalyst_capacity_low_g": ("capacity_low_g", _NUMBER, "lower end of its 90 % interval, g"),
    "catalyst_capacity_high_g": (
        "capacity_high_g",
        _NUMBER,
        "upper end of its 90 % interval, g; null if the estimate is a lower bound",
    ),
    "catalyst_verdict": (
        "verdict",
        _TEXT,
        "passed, failed or inconclusive; null without a downstream voltage, as all of the catalyst",
    ),
    "downstream_verdict": ("sensor_verdict", _TEXT, "verdict on the downstream sensor"),
    "balance_verdict": (
        "balance_verdict",
        _TEXT,
        "verdict on the upstream sensor against the oxygen balance",
    ),
    "upstream_offset": (
        "upstream_offset_lambda",
        _NUMBER,
        "offset of the upstream sensor by the oxygen balance, lambda",
    ),
    "upstream_offset_std": (
        "upstream_offset_std",
        _NUMBER,
        "standard error of that offset, lambda",
    ),
}
BEHIND_KEYS: Final = {name: key for name, (key, _, _) in _BEHIND.items()}

# column → counter in the JSON of ``o2mon replay``, and of what it is the number
_COUNTED: Final = {
    "frames_unmapped": ("unmapped", "frames without a signal that the monitor needs"),
    "frames_skipped": ("skipped", "error frames and remote frames"),
    "frames_length": ("length", "frames dropped for a wrong number of bytes"),
    "frames_checksum": ("checksum", "frames dropped for a wrong checksum"),
    "frames_stuck": ("stuck", "frames dropped because their counter did not advance"),
    "frames_lost": ("lost", "missing frames by the counters of the messages"),
    "frames_late": ("late", "frames dropped because they are older than the current sample"),
    "discontinuities": ("discontinuities", "time jumps at which the sample grid starts again"),
    "values_not_available": ("not_available", "values that the sender marks as not available"),
}
COUNTERS: Final = {name: key for name, (key, _) in _COUNTED.items()} | {
    "values_out_of_range": "out_of_range"
}

RECORDINGS: Final[Columns] = {
    **WHICH,
    "error": (_TEXT, "reason why the recording could not be judged, null if judged"),
    "sha256": (_TEXT, "sha256 of the file"),
    "size_bytes": (pl.UInt64(), "size of the file, bytes"),
    "source": (_TEXT, "source in the manifest.json beside the file, for example simulated"),
    **_START,
    "samples": (pl.UInt32(), "number of samples on the grid of the model"),
    "duration_s": (_NUMBER, "number of samples times the period of the grid, s"),
    "enabled_s": (_NUMBER, "time in which all enable conditions hold, s"),
    "windows": (pl.UInt32(), "number of complete windows"),
    "windows_interrupted": (pl.UInt32(), "number of windows that began and were discarded"),
    "windows_passed": (pl.UInt32(), "number of windows with the verdict passed"),
    "windows_failed": (pl.UInt32(), "number of windows with the verdict failed"),
    "windows_inconclusive": (pl.UInt32(), "number of windows with the verdict inconclusive"),
    "windows_excited": (pl.UInt32(), "number of windows whose prediction moves clearly"),
    "windows_paper_failed": (pl.UInt32(), "number of windows that fail the paper's rule"),
    "completed": (pl.Boolean(), "true if the response test reached a decision"),
    "fault_flag": (pl.Boolean(), "true if a code is pending or confirmed at the end of the drive"),
    "codes": (_TEXTS, "trouble codes that are pending or confirmed at the end of the drive"),
    "faults": (_TEXTS, "name of the fault, one per code"),
    "states": (_TEXTS, "pending or confirmed, one per code"),
    "first_code_s": (_NUMBER, "time from the start to the first code of this drive, s"),
    "first_code_enabled_s": (_NUMBER, "enabled time up to the first code of this drive, s"),
    "residual_mean": (_NUMBER, "mean of the residual over all windows, output's unit"),
    "residual_std": (
        _NUMBER,
        "root mean square of the residual's standard deviations in the windows, output's unit",
    ),
    "offset": (_NUMBER, "last estimate of the sensor's offset, output's unit"),
    "gain": (
        _NUMBER,
        "last estimate of the gain of measurement over prediction, 1 if the sensor follows the "
        "model",
    ),
    **{name: (kind, f"last estimate: {text}") for name, (kind, text) in ESTIMATES.items()},
    "evidence": (
        _NUMBER,
        "log likelihood of the best faulty sensor over the best sound sensor, largest value that "
        "two successive windows reach",
    ),
    "offset_beyond": (
        _NUMBER,
        "distance of the offset from the healthy offsets in standard deviations, below 0 inside "
        "them; largest value that two successive windows reach",
    ),
    "reference_drives": (pl.UInt32(), "number of earlier drives in the reference of the vehicle"),
    "offset_low": (_NUMBER, "lower limit of the offset in this drive, output's unit"),
    "offset_high": (_NUMBER, "upper limit of the offset in this drive, output's unit"),
    "reference_gain": (_NUMBER, "healthy gain of this vehicle"),
    **{name: (kind, text) for name, (_, kind, text) in _BEHIND.items()},
    "samples_stale": (pl.UInt32(), "number of samples with a stale signal of the model"),
    "samples_invalid": (
        pl.UInt32(),
        "number of samples with a signal of the model that is not available or not a number",
    ),
    "samples_out_of_range": (
        pl.UInt32(),
        "number of samples with an implausible signal of the model",
    ),
    **{
        name: (pl.UInt64(), f"number of {text}; null for tables")
        for name, (_, text) in _COUNTED.items()
    },
    "values_out_of_range": (pl.UInt64(), "number of implausible values"),
    "never_received": (
        _TEXTS,
        "messages of the signal map that the recording does not contain; null for tables",
    ),
    **{
        f"held_{name}": (
            _NUMBER,
            f"share of the samples at which {name} holds, 0 to 1, null if unavailable",
        )
        for name in CONDITIONS
    },
}

WINDOWS: Final[Columns] = {
    **WHICH,
    **_START,
    "window": (pl.UInt32(), "number of the window in the recording, from 0"),
    "t_start_s": (_NUMBER, "time of the first sample, s from the start of the recording"),
    "t_end_s": (_NUMBER, "time of the last sample, s from the start of the recording"),
    "mean": (_NUMBER, "mean of the residual, output's unit"),
    "std": (_NUMBER, "standard deviation of the residual, output's unit"),
    "paper_failed": (pl.Boolean(), "true if mean and std fail the paper's rule"),
    "verdict": (_TEXT, "passed, failed or inconclusive"),
    "fault": (_TEXT, "name of the fault, null without a fault"),
    "also": (_TEXTS, "further faults that the window cannot distinguish from the named fault"),
    "excited": (pl.Boolean(), "true if the prediction moves clearly"),
    "excitation": (_NUMBER, "standard deviation of the prediction, phi"),
    "evidence": (_NUMBER, "log likelihood of the best faulty sensor over the best sound sensor"),
    "hypothesis": (_TEXT, "likeliest sensor: healthy or the name of a fault"),
    **ESTIMATES,
    "gain": (_NUMBER, "estimated gain of measurement over prediction"),
    "gain_std": (_NUMBER, "standard deviation of the gain"),
    "offset": (_NUMBER, "estimated offset, output's unit"),
    "offset_std": (_NUMBER, "standard deviation of the offset, output's unit"),
    "offset_beyond": (
        _NUMBER,
        "distance of the offset from the healthy offsets in standard deviations, below 0 inside "
        "them",
    ),
}


def schema(columns: Columns) -> dict[str, pl.DataType]:
    """Return the types of the columns of a table, name → type."""
    return {name: kind for name, (kind, _) in columns.items()}
