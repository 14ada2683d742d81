"""Columns of the two tables of a fleet, with types, units and descriptions.

docs/reference/fleet_tables.md repeats the descriptions; a test compares them.
"""

from typing import Final

import polars as pl

from monitor.judge.enable import CONDITIONS

Columns = dict[str, tuple[pl.DataType, str]]
_TEXTS: Final = pl.List(pl.String())

_WHICH: Final[Columns] = {
    "recording": (pl.UInt32(), "number of the recording in the order of the command, from 0"),
    "path": (pl.String(), "path or URL of the recording"),
    "vehicle": (pl.String(), "vehicle by the manifest or --vehicle, otherwise the file name"),
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
        pl.Float64(),
        f"{'standard deviation of the' if kind else 'estimated'} {text} on "
        f"{edge.replace('_', ' ')} edges, s",
    )
    for what, text in (("lag", "lag"), ("dead_time", "dead time"))
    for edge in ("rich_to_lean", "lean_to_rich")
    for kind in ("", "_std")
}

BEHIND: Final[Columns] = {
    "catalyst_capacity_g": (pl.Float64(), "estimated oxygen storage of the catalyst, g"),
    "catalyst_capacity_low_g": (pl.Float64(), "lower end of its 90 % interval, g"),
    "catalyst_capacity_high_g": (
        pl.Float64(),
        "upper end of its 90 % interval, g; null if the estimate is a lower bound",
    ),
    "catalyst_verdict": (
        pl.String(),
        "passed, failed or inconclusive; null without a downstream voltage, as all of the catalyst",
    ),
    "downstream_verdict": (pl.String(), "verdict on the downstream sensor"),
    "balance_verdict": (pl.String(), "verdict on the upstream sensor against the oxygen balance"),
    "upstream_offset": (
        pl.Float64(),
        "offset of the upstream sensor by the oxygen balance, lambda",
    ),
    "upstream_offset_std": (pl.Float64(), "standard error of that offset, lambda"),
}
BEHIND_KEYS: Final = {
    "catalyst_capacity_g": "capacity_g",
    "catalyst_capacity_low_g": "capacity_low_g",
    "catalyst_capacity_high_g": "capacity_high_g",
    "catalyst_verdict": "verdict",
    "downstream_verdict": "sensor_verdict",
    "balance_verdict": "balance_verdict",
    "upstream_offset": "upstream_offset_lambda",
    "upstream_offset_std": "upstream_offset_std",
}
RECORDINGS: Final[Columns] = {
    **_WHICH,
    "error": (pl.String(), "reason why the recording could not be judged, null if judged"),
    "sha256": (pl.String(), "sha256 of the file"),
    "size_bytes": (pl.UInt64(), "size of the file, bytes"),
    "source": (pl.String(), "source in the manifest.json beside the file, for example simulated"),
    **_START,
    "samples": (pl.UInt32(), "number of samples on the grid of the model"),
    "duration_s": (pl.Float64(), "number of samples times the period of the grid, s"),
    "enabled_s": (pl.Float64(), "time in which all enable conditions hold, s"),
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
    "first_code_s": (pl.Float64(), "time from the start to the first code of this drive, s"),
    "first_code_enabled_s": (pl.Float64(), "enabled time up to the first code of this drive, s"),
    "residual_mean": (pl.Float64(), "mean of the residual over all windows, output's unit"),
    "residual_std": (
        pl.Float64(),
        "root mean square of the residual's standard deviations in the windows, output's unit",
    ),
    "offset": (pl.Float64(), "last estimate of the sensor's offset, output's unit"),
    "gain": (
        pl.Float64(),
        "last estimate of the gain of measurement over prediction, 1 if the sensor follows the "
        "model",
    ),
    **{name: (kind, f"last estimate: {text}") for name, (kind, text) in ESTIMATES.items()},
    "evidence": (
        pl.Float64(),
        "log likelihood of the best faulty sensor over the best sound sensor, largest value that "
        "two successive windows reach",
    ),
    "offset_beyond": (
        pl.Float64(),
        "distance of the offset from the healthy offsets in standard deviations, below 0 inside "
        "them; largest value that two successive windows reach",
    ),
    "reference_drives": (pl.UInt32(), "number of earlier drives in the reference of the vehicle"),
    "offset_low": (pl.Float64(), "lower limit of the offset in this drive, output's unit"),
    "offset_high": (pl.Float64(), "upper limit of the offset in this drive, output's unit"),
    "reference_gain": (pl.Float64(), "healthy gain of this vehicle"),
    **BEHIND,
    "samples_stale": (pl.UInt32(), "number of samples with a stale signal of the model"),
    "samples_invalid": (
        pl.UInt32(),
        "number of samples with a signal of the model that is not available or not a number",
    ),
    "samples_out_of_range": (
        pl.UInt32(),
        "number of samples with an implausible signal of the model",
    ),
    "frames_unmapped": (
        pl.UInt64(),
        "number of frames without a signal that the monitor needs; null for tables",
    ),
    "frames_skipped": (pl.UInt64(), "number of error frames and remote frames; null for tables"),
    "frames_length": (
        pl.UInt64(),
        "number of frames dropped for a wrong number of bytes; null for tables",
    ),
    "frames_checksum": (
        pl.UInt64(),
        "number of frames dropped for a wrong checksum; null for tables",
    ),
    "frames_stuck": (
        pl.UInt64(),
        "number of frames dropped because their counter did not advance; null for tables",
    ),
    "frames_lost": (
        pl.UInt64(),
        "number of missing frames by the counters of the messages; null for tables",
    ),
    "frames_late": (
        pl.UInt64(),
        "number of frames dropped because they are older than the current sample; null for tables",
    ),
    "discontinuities": (
        pl.UInt64(),
        "number of time jumps at which the sample grid starts again; null for tables",
    ),
    "values_not_available": (
        pl.UInt64(),
        "number of values that the sender marks as not available; null for tables",
    ),
    "values_out_of_range": (pl.UInt64(), "number of implausible values"),
    "never_received": (
        _TEXTS,
        "messages of the signal map that the recording does not contain; null for tables",
    ),
    **{
        f"held_{name}": (
            pl.Float64(),
            f"share of the samples at which {name} holds, 0 to 1, null if unavailable",
        )
        for name in CONDITIONS
    },
}

WINDOWS: Final[Columns] = {
    **_WHICH,
    **_START,
    "window": (pl.UInt32(), "number of the window in the recording, from 0"),
    "t_start_s": (pl.Float64(), "time of the first sample, s from the start of the recording"),
    "t_end_s": (pl.Float64(), "time of the last sample, s from the start of the recording"),
    "mean": (pl.Float64(), "mean of the residual, output's unit"),
    "std": (pl.Float64(), "standard deviation of the residual, output's unit"),
    "paper_failed": (pl.Boolean(), "true if mean and std fail the paper's rule"),
    "verdict": (pl.String(), "passed, failed or inconclusive"),
    "fault": (pl.String(), "name of the fault, null without a fault"),
    "also": (_TEXTS, "further faults that the window cannot distinguish from the named fault"),
    "excited": (pl.Boolean(), "true if the prediction moves clearly"),
    "excitation": (pl.Float64(), "standard deviation of the prediction, phi"),
    "evidence": (
        pl.Float64(),
        "log likelihood of the best faulty sensor over the best sound sensor",
    ),
    "hypothesis": (pl.String(), "likeliest sensor: healthy or the name of a fault"),
    **ESTIMATES,
    "gain": (pl.Float64(), "estimated gain of measurement over prediction"),
    "gain_std": (pl.Float64(), "standard deviation of the gain"),
    "offset": (pl.Float64(), "estimated offset, output's unit"),
    "offset_std": (pl.Float64(), "standard deviation of the offset, output's unit"),
    "offset_beyond": (
        pl.Float64(),
        "distance of the offset from the healthy offsets in standard deviations, below 0 inside "
        "them",
    ),
}


# column → name of the counter in the JSON of ``o2mon replay``
COUNTERS: Final = {
    "frames_unmapped": "unmapped",
    "frames_skipped": "skipped",
    "frames_length": "length",
    "frames_checksum": "checksum",
    "frames_stuck": "stuck",
    "frames_lost": "lost",
    "frames_late": "late",
    "discontinuities": "discontinuities",
    "values_not_available": "not_available",
    "values_out_of_range": "out_of_range",
}


def schema(columns: Columns) -> dict[str, pl.DataType]:
    """Return the types of the columns of a table, name → type."""
    return {name: kind for name, (kind, _) in columns.items()}
