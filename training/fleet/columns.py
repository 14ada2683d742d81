"""The two tables of a fleet: their columns with types and units."""

from typing import Final

import polars as pl

from monitor.judge.enable import CONDITIONS

Columns = dict[str, tuple[pl.DataType, str]]
_TEXTS: Final = pl.List(pl.String())

_WHICH: Final[Columns] = {
    "recording": (pl.UInt32(), "number, in the order in which the recordings were given"),
    "path": (pl.String(), "path or URL"),
    "vehicle": (pl.String(), "as the manifest or --vehicle says; else the file's name"),
    "drive": (pl.UInt32(), "number of this vehicle's drive, from 0"),
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

RECORDINGS: Final[Columns] = {
    **_WHICH,
    "error": (pl.String(), "why it could not be judged, null if it could"),
    "sha256": (pl.String(), "of the file"),
    "size_bytes": (pl.UInt64(), "of the file, in bytes"),
    "source": (pl.String(), "what the manifest.json beside it says: simulated"),
    "samples": (pl.UInt32(), "on the model's grid"),
    "duration_s": (pl.Float64(), "samples times the grid's period, s"),
    "enabled_s": (pl.Float64(), "of it all enable conditions hold, s"),
    "windows": (pl.UInt32(), "full windows"),
    "windows_interrupted": (pl.UInt32(), "windows that were begun and discarded"),
    "windows_passed": (pl.UInt32(), "judged sound"),
    "windows_failed": (pl.UInt32(), "judged faulty"),
    "windows_inconclusive": (pl.UInt32(), "without enough evidence"),
    "windows_excited": (pl.UInt32(), "in which the prediction moves enough to be judged"),
    "windows_paper_failed": (pl.UInt32(), "that fail the paper's rule"),
    "completed": (pl.Boolean(), "the response test reached a decision"),
    "fault_flag": (pl.Boolean(), "a code is pending or confirmed at the end"),
    "codes": (_TEXTS, "trouble codes that are pending or confirmed at the end"),
    "faults": (_TEXTS, "the fault's name, for each of the codes"),
    "states": (_TEXTS, "pending or confirmed, for each of the codes"),
    "first_code_s": (pl.Float64(), "when the first code was set in this drive, s from its begin"),
    "first_code_enabled_s": (pl.Float64(), "enabled time until then, s"),
    "residual_mean": (pl.Float64(), "mean of the windows' mean residuals, output's unit"),
    "residual_std": (pl.Float64(), "root mean square of the windows' spreads, output's unit"),
    "offset": (pl.Float64(), "last estimate of the sensor's offset, output's unit"),
    "gain": (pl.Float64(), "last estimate of measurement over prediction, 1 is the model's"),
    **{name: (kind, f"last estimate: {text}") for name, (kind, text) in ESTIMATES.items()},
    "evidence": (pl.Float64(), "for a faulty sensor, the largest that two windows in a row reach"),
    "offset_beyond": (
        pl.Float64(),
        "standard deviations that the offset lies outside the healthy ones, the largest that two "
        "windows in a row reach; below 0 inside",
    ),
    "reference_drives": (pl.UInt32(), "earlier drives that the vehicle's reference had learned"),
    "offset_low": (pl.Float64(), "lower limit of the offset in this drive, output's unit"),
    "offset_high": (pl.Float64(), "upper limit of the offset in this drive, output's unit"),
    "reference_gain": (pl.Float64(), "gain that is healthy for this vehicle"),
    "samples_stale": (pl.UInt32(), "samples at which a signal the model needs was too old"),
    "samples_invalid": (pl.UInt32(), "at which one was marked as not available, or no number"),
    "samples_out_of_range": (pl.UInt32(), "at which one was implausible"),
    "frames_unmapped": (pl.UInt64(), "frames nobody asked for; null for tables, as below"),
    "frames_skipped": (pl.UInt64(), "error frames and remote frames"),
    "frames_length": (pl.UInt64(), "dropped: wrong number of bytes"),
    "frames_checksum": (pl.UInt64(), "dropped: checksum does not hold"),
    "frames_stuck": (pl.UInt64(), "dropped: counter did not advance"),
    "frames_lost": (pl.UInt64(), "that the counters say are missing"),
    "frames_late": (pl.UInt64(), "dropped: older than the sample under way"),
    "discontinuities": (pl.UInt64(), "breaks of the time, at which the grid began anew"),
    "values_not_available": (pl.UInt64(), "values that the sender marked so"),
    "values_out_of_range": (pl.UInt64(), "implausible values; also of tables"),
    "never_received": (_TEXTS, "messages of the signal map that never came"),
    **{
        f"held_{name}": (pl.Float64(), f"share of the samples at which {name} holds, 0 to 1")
        for name in CONDITIONS
    },
}

WINDOWS: Final[Columns] = {
    **_WHICH,
    "window": (pl.UInt32(), "number in the recording, from 0"),
    "t_start_s": (pl.Float64(), "its first sample, s from the recording's first"),
    "t_end_s": (pl.Float64(), "its last sample, s from the recording's first"),
    "mean": (pl.Float64(), "of the residual, output's unit"),
    "std": (pl.Float64(), "of the residual, output's unit"),
    "paper_failed": (pl.Boolean(), "the paper's rule: both reach their limits"),
    "verdict": (pl.String(), "passed, failed or inconclusive"),
    "fault": (pl.String(), "name of the fault, null without one"),
    "also": (_TEXTS, "faults that cannot be told from it"),
    "excited": (pl.Boolean(), "the prediction moves enough to be judged"),
    "excitation": (pl.Float64(), "standard deviation of the prediction, phi"),
    "evidence": (pl.Float64(), "log likelihood of the best faulty sensor over the best sound one"),
    "hypothesis": (pl.String(), "likeliest sensor: healthy or a fault's name"),
    **ESTIMATES,
    "gain": (pl.Float64(), "estimated gain of measurement over prediction"),
    "gain_std": (pl.Float64(), "its standard deviation"),
    "offset": (pl.Float64(), "estimated offset, output's unit"),
    "offset_std": (pl.Float64(), "its standard deviation, output's unit"),
    "offset_beyond": (pl.Float64(), "standard deviations outside the healthy offsets"),
}


# Counter of ``o2mon.replay/1`` by column.
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
    """Return the types of a table's columns."""
    return {name: kind for name, (kind, _) in columns.items()}
