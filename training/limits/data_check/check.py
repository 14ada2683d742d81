"""The data check: judge before a training whether recordings suffice to train a model.

Every finding has a level: ok, warning (the training works, the model suffers) or error (the
training is impossible or useless). Its text compares the recordings with the requirement.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from monitor.base.files.manifest import entry_of
from training.limits.data_check.inputs import COPY_LAGS, copies, covered, excited
from training.limits.data_check.samples import DataFinding, closed_loop, enough, usable
from training.recordings.recording import Recording

SCHEMA = "o2train.check/2"


def check(
    recordings: Sequence[Recording],
    inputs: Sequence[str],
    output: str,
    *,
    unreadable: Sequence[str] = (),
) -> dict[str, Any]:
    """Return findings and figures as JSON values; ``usable`` is False if a finding is an error.

    unreadable : one error message per file that could not be read
    """
    findings = [DataFinding("error", "file", text) for text in unreadable]
    figures: dict[str, Any] = {"coverage": None, "excitation": []}
    named = _signals(recordings, inputs, output)
    findings += _or_well(named, "missing channels", "every recording has all signals")
    findings += _files(recordings)
    if not any(f.level == "error" for f in findings):
        data, on_samples = usable(recordings, inputs, output)
        findings += on_samples
        if data.u:
            findings.append(enough(recordings, data, len(inputs), output))
            findings += [closed_loop(recordings, data), covered(recordings, figures)]
            moves = excited(recordings, data, inputs, figures)
            findings += _or_well(moves, "excitation", "every input moves")
            text = f"no input is a scaled or shifted copy of {output} (within {COPY_LAGS} samples)"
            findings += _or_well(copies(data, inputs, output), "leak", text)
    return {
        "schema": SCHEMA,
        "usable": not any(f.level == "error" for f in findings),
        "inputs": list(inputs),
        "output": output,
        "recordings": [
            {
                "path": str(r.path),
                "sha256": r.sha256,
                "samples": len(r.t_s),
                "period_s": r.period_ns / 1e9,
                "duration_s": len(r.t_s) * (r.period_ns / 1e9),
                "source": entry_of(Path(r.path), r.sha256).get("source"),
            }
            for r in recordings
        ],
        "findings": [f._asdict() for f in findings],
        **figures,
    }


def _or_well(found: Iterable[DataFinding], topic: str, text: str) -> list[DataFinding]:
    return [*found] or [DataFinding("ok", topic, text)]


def _signals(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> Iterator[DataFinding]:
    if not recordings:
        yield DataFinding("error", "file", "no recording can be read, at least one is wanted")
        return
    if output in inputs:
        yield DataFinding("error", "names", f"{output} is both an input and the output")
    for name in dict.fromkeys(n for n in inputs if list(inputs).count(n) > 1):
        yield DataFinding("error", "names", f"input {name} is named more than once")
    for r in recordings:
        lost = [n for n in (*inputs, output) if n not in r.names]
        if lost:
            text = f"{r.path}: no {', '.join(lost)}; there are {', '.join(r.names)}"
            yield DataFinding("error", "missing channels", text)


def _files(recordings: Sequence[Recording]) -> Iterator[DataFinding]:
    known: dict[str, Recording] = {}
    for r in recordings:
        first, same = recordings[0], known.setdefault(r.sha256, r)
        if r.period_ns != first.period_ns:
            text = (
                f"{r.path}: sample period {r.period_ns / 1e9:g} s, {first.path} has "
                f"{first.period_ns / 1e9:g} s; one grid is wanted (--period)"
            )
            yield DataFinding("error", "sample period", text)
        if same is not r:
            text = f"{r.path}: the same as {same.path}; held-out blocks would leak"
            yield DataFinding("error", "repeated file", text)
