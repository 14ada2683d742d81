"""The data check: judge before a training whether recordings suffice to train a model.

Every finding has a level: ok, warning (the training works, the model suffers) or error (the
training is impossible or useless). Its text compares the recordings with the requirement.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from monitor.base.errors import UsageError
from training.limits.data_check.inputs import COPY_LAGS, copies, covered, excited
from training.limits.data_check.samples import DataFinding, driven, usable
from training.recordings.recording import Recording, check_each_once
from training.recordings.samples.preparation import problems

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
    none = [] if recordings else ["no recording can be read, at least one is wanted"]
    findings = [DataFinding("error", "file", text) for text in (*unreadable, *none)]
    figures: dict[str, Any] = {"coverage": None, "excitation": []}
    if recordings:
        missing = _missing(recordings, (*inputs, output))
        findings += _or_well(missing, "missing channels", "every recording has all signals")
        findings += _contradictions(recordings, inputs, output)
    if not any(f.level == "error" for f in findings):
        data, on_samples = usable(recordings, inputs, output)
        findings += on_samples
        if data:
            findings += driven(recordings, data, len(inputs), output)
            findings.append(covered(recordings, figures))
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
                "source": r.entry.get("source"),
            }
            for r in recordings
        ],
        "findings": [f._asdict() for f in findings],
        **figures,
    }


def _or_well(found: Iterable[DataFinding], topic: str, text: str) -> list[DataFinding]:
    return [*found] or [DataFinding("ok", topic, text)]


def _missing(recordings: Sequence[Recording], names: Sequence[str]) -> Iterator[DataFinding]:
    for r in recordings:
        if lost := [n for n in names if n not in r.names]:
            text = f"{r.path}: no {', '.join(lost)}; there are {', '.join(r.names)}"
            yield DataFinding("error", "missing channels", text)


def _contradictions(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> Iterator[DataFinding]:
    for topic, error in problems(recordings, inputs, output):
        yield DataFinding("error", topic, str(error))
    try:
        check_each_once(recordings)
    except UsageError as error:
        yield DataFinding("error", "repeated file", f"{error}; held-out blocks would leak")
