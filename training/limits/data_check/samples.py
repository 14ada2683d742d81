"""Findings on the samples: gaps, outliers, constants, duration, time in closed loop."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from monitor.base.counts import counted, duration, plain
from monitor.base.errors import RecordingError
from monitor.base.runs import runs
from monitor.base.types import FloatArray
from training.limits.decision_limits import MINIMUM_WINDOWS
from training.narx.network import Spec
from training.recordings.recording import Recording
from training.recordings.samples import preparation

LAGS = 5  # of a small network
SHORTEST_STRETCH = 8 * LAGS  # training.recordings.samples.preparation drops shorter ones
SMALLEST = (2,)  # neurons per hidden layer of the smallest useful network
WINDOW = 50  # samples of a window, Model Based Diagnosis of Oxygen Sensors, section 2
LOST = 0.05  # share of invalid samples above which a signal gets a warning
OUTLIERS = 0.001  # share of outliers above which sensor or decoding is suspect
CLOSED_LOOP = 0.5  # least share of enabled samples; warm drives have 0.7 and more


class DataFinding(NamedTuple):
    """One finding of the data check."""

    level: str  # ok, warning or error
    topic: str
    text: str


def usable(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> tuple[preparation.Stretches | None, list[DataFinding]]:
    """Return what a training can use, the output as recorded, and findings on the samples."""
    names, outliers = (*inputs, output), dict[str, int]()
    columns = [preparation.columns_of(r, names, outliers) for r in recordings]
    for r, values in zip(recordings, columns, strict=True):
        values[preparation.pinned_rows(r, output), -1] = np.nan  # as a training does
    findings = [
        finding
        for name, values in zip(names, np.concatenate(columns).T, strict=True)
        for finding in _one_signal(name, values, outliers.get(name, 0))
    ]
    try:
        cut = preparation.stretches_of(recordings, inputs, output, "none", SHORTEST_STRETCH)
    except RecordingError as error:
        return None, [*findings, DataFinding("error", "gaps", str(error))]
    findings += [DataFinding("warning", "gaps", text) for text in cut.unused]
    if not any(f.topic == "gaps" for f in findings):
        lengths = [s.stop - s.start for s in cut.segments]
        text = f"unbroken stretches: {len(lengths)}, the longest of {max(lengths)} samples"
        findings.append(DataFinding("ok", "gaps", text))
    return cut, findings


def _one_signal(name: str, values: FloatArray, outliers: int) -> Iterator[DataFinding]:
    valid = values[np.isfinite(values)]
    if not len(valid):
        yield DataFinding("error", "missing channels", f"{name} is never valid")
        return
    if np.ptp(valid) <= 1e-9 * max(1.0, float(np.abs(valid).max())):
        text = f"{name} is constant ({plain(valid[0], 6)}): it teaches nothing, leave it out"
        yield DataFinding("error", "constant", text)
    lost = 1.0 - (len(valid) + outliers) / len(values)
    if lost > LOST:
        longest = max(b - a for a, b in runs(np.isnan(values)))
        text = (
            f"{name} is not valid in {100 * lost:.1f} % of the samples, longest gap {longest} "
            f"samples; below {100 * LOST:g} % is wanted"
        )
        yield DataFinding("warning", "gaps", text)
    if outliers > OUTLIERS * len(values):
        text = (
            f"{name} has {counted(outliers, 'outlier')}, {100 * outliers / len(values):.2f} %; "
            f"below {100 * OUTLIERS:g} % is usual: look at sensor, unit and decoding"
        )
        yield DataFinding("warning", "outliers", text)


def driven(
    recordings: Sequence[Recording], data: preparation.Stretches, n_inputs: int, output: str
) -> list[DataFinding]:
    """Return findings on the duration (for a training, whole blocks, and limits) and on the time in
    closed loop, outside fuel cut, with a ready sensor.
    """
    period_s, valid = recordings[0].period_ns / 1e9, np.isfinite(data.y)
    samples, enabled = int(valid.sum()), int((data.enabled & valid).sum())
    seconds, enabled_s = samples * period_s, enabled * period_s
    is_lambda = preparation.output_transform(output) == "phi"
    least = Spec(n_inputs, LAGS, SMALLEST).n_weights
    wanted_s, whole_s = MINIMUM_WINDOWS * WINDOW * period_s, preparation.GROUP * preparation.BLOCK_S
    text, level = f"{duration(seconds)} usable", "ok"
    if samples < least:
        text += f": {samples} samples, even {SMALLEST[0]} neurons have {least} weights"
        level = "error"
    elif is_lambda and seconds < whole_s:
        text += f", at least {duration(whole_s)} are wanted to hold out whole blocks"
        level = "warning"
    elif is_lambda and enabled_s < wanted_s:
        text += f", {duration(enabled_s)} in the enabled region; {duration(wanted_s)} are wanted "
        text, level = f"{text}to set limits", "warning"
    return [DataFinding(level, "duration", text), _closed_loop(recordings, enabled_s, seconds)]


def _closed_loop(recordings: Sequence[Recording], enabled_s: float, seconds: float) -> DataFinding:
    recorded = [n for n in preparation.ENABLE_COLUMNS if any(n in r.names for r in recordings)]
    if not recorded:
        text = "the recordings do not say when the loop was closed: every sample counts alike"
        return DataFinding("ok", "closed loop", text)
    share, names = enabled_s / seconds, ", ".join(recorded)
    text = f"{duration(enabled_s)}, {100 * share:.0f} % of the usable samples (by {names})"
    if share >= CLOSED_LOOP:
        return DataFinding("ok", "closed loop", text)
    wanted = f"{100 * CLOSED_LOOP:g} % are wanted, the rest weighs little in the training"
    return DataFinding("warning", "closed loop", f"{text}; {wanted}")
