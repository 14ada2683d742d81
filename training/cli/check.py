"""The command ``o2train check``: judge before a training whether recordings suffice."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from monitor.base.command_line.parameters import Output
from training.cli.options import GridOptions, SignalOptions, SomeRecordings, inputs_of, load_all

if TYPE_CHECKING:
    from training.recordings.recording import Recording

EXAMPLES = """examples:
  o2train check drive1.log drive2.log drive3.log
  o2train check run_*.csv.gz --inputs speed_z load_z ignition_angle_z fuel_cutoff_z \\
      --output lambda_z --html check.html

Every finding is ok, a warning or an error. Exit code 0: no errors, the recordings can be used.
Exit code 2: at least one error, the recordings cannot be used."""


def run(
    recordings: SomeRecordings,
    *,
    signals: SignalOptions,
    reading: GridOptions,
    json: Output = None,
    html: Output = None,
) -> int:
    """Judge whether recordings suffice to train a model.

    The command checks duration, coverage of speed and load, motion of every input, time in closed
    loop, missing channels, gaps, and inputs that copy the output.

    json : write findings and figures as JSON
    html : write an HTML report
    Raises RecordingError if the recordings cannot be used (exit code 2).
    """
    from monitor.base.errors import RecordingError
    from monitor.base.files.outputs import write_text
    from monitor.base.signals import NARX_INPUTS, OUTPUT
    from training.jobs.run_folder import write_json
    from training.limits.data_check.check import check
    from training.limits.data_check.findings import as_page, as_text, verdict

    found, unreadable = _load(reading, recordings)
    inputs = inputs_of(signals, found) if found else (signals.inputs or NARX_INPUTS)
    result = check(found, inputs, signals.output or OUTPUT, unreadable=unreadable)
    print(as_text(result))
    if json:
        write_json(json, result, indent=1)
    if html:
        write_text(html, as_page(result))
    if not result["usable"]:
        first = next(f["text"] for f in result["findings"] if f["level"] == "error")
        raise RecordingError(f"{verdict(result)}; the first: {first}")
    return 0


def _load(reading: GridOptions, given: Sequence[Path]) -> tuple["list[Recording]", list[str]]:
    """Return the readable recordings, and one error message per unreadable file."""
    from monitor.base.errors import RecordingError

    recordings: list[Recording] = []
    unreadable: list[str] = []
    for path in given:
        try:
            recordings += load_all(reading, [path], reading.period)
        except RecordingError as error:
            unreadable.append(str(error))
        except OSError as error:
            unreadable.append(f"{path}: {error.strerror or error}")
    return recordings, unreadable
