"""The data check: judge before a training whether recordings suffice to train a model.

Every finding has a level: ok, warning (the training works, the model suffers) or error (the
training is impossible or useless). Its text compares the recordings with the requirement.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from monitor.base.files.manifest import source_of
from training.limits.data_check.inputs import copies, covered, excited
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
    findings += _setup(recordings, inputs, output)
    if not any(f.level == "error" for f in findings):
        data, on_samples = usable(recordings, inputs, output)
        findings += on_samples
        if data.u:
            findings += enough(recordings, data, len(inputs), output)
            findings += closed_loop(recordings, data)
            findings += covered(recordings, figures)
            findings += excited(recordings, data, inputs, figures)
            findings += copies(data, inputs, output)
    return {
        "schema": SCHEMA,
        "usable": not any(f.level == "error" for f in findings),
        "inputs": list(inputs),
        "output": output,
        "recordings": [_recording(r) for r in recordings],
        "findings": [asdict(f) for f in findings],
        **figures,
    }


def _recording(r: Recording) -> dict[str, Any]:
    period_s = r.period_ns / 1e9
    return {
        "path": str(r.path),
        "sha256": r.sha256,
        "samples": len(r.t_s),
        "period_s": period_s,
        "duration_s": len(r.t_s) * period_s,
        "source": source_of(Path(r.path), r.sha256),
    }


def _setup(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> list[DataFinding]:
    """Return the findings on names, periods and files; an error here ends the check."""
    findings = []
    if not recordings:
        return [DataFinding("error", "file", "no recording can be read, at least one is wanted")]
    if output in inputs:
        findings.append(DataFinding("error", "names", f"{output} is both an input and the output"))
    twice = dict.fromkeys(n for n in inputs if list(inputs).count(n) > 1)
    findings += [DataFinding("error", "names", f"input {n} is named more than once") for n in twice]
    for r in recordings:
        lost = [n for n in (*inputs, output) if n not in r.names]
        if lost:
            text = f"{r.path}: no {', '.join(lost)}; there are {', '.join(r.names)}"
            findings.append(DataFinding("error", "missing channels", text))
    if not findings:
        findings.append(DataFinding("ok", "missing channels", "every recording has all signals"))
    first = recordings[0]
    for r in recordings[1:]:
        if r.period_ns != first.period_ns:
            text = (
                f"{r.path}: sample period {r.period_ns / 1e9:g} s, {first.path} has "
                f"{first.period_ns / 1e9:g} s; one grid is wanted (--period)"
            )
            findings.append(DataFinding("error", "sample period", text))
    by_sha256: dict[str, Recording] = {}
    for r in recordings:
        if r.sha256 in by_sha256:
            first = by_sha256[r.sha256]
            text = f"{r.path} and {first.path} are the same file: held-out blocks leak"
            findings.append(DataFinding("warning", "repeated file", text))
        by_sha256.setdefault(r.sha256, r)
    return findings
