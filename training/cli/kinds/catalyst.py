"""The part of ``o2train fit --kind greybox`` for a catalyst and its downstream sensor."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from training.cli.kinds.fit_command import FitCommand

if TYPE_CHECKING:
    from training.greybox.catalyst import FittedCatalyst
    from training.recordings.recording import Recording

OUTPUT: Final = "downstream_voltage_v"


def run(args: FitCommand) -> int:
    """Fit catalyst and downstream sensor, write the constants as JSON, and return exit code 0.

    Raises UsageError or RecordingError (exit code 2).
    """
    import json

    from monitor.base.errors import UsageError
    from monitor.base.files.outputs import write_text
    from training.greybox.catalyst import drive_of, fit
    from training.recordings.recording import check_each_once

    if args.out.suffix != ".json":
        raise UsageError(f"--out {args.out}: the constants of a catalyst are written as .json")
    if args.inputs or args.report:
        raise UsageError("--inputs, --report: a fit of a catalyst has no such thing")
    recordings = [_load(path, args) for path in args.recordings]
    check_each_once(recordings)
    fitted = fit([drive_of(recording) for recording in recordings])
    tree = asdict(fitted) | {"sha256": [recording.sha256 for recording in recordings]}
    write_text(args.out, json.dumps(tree, indent=1) + "\n")
    _print(args.out, fitted)
    return 0


def _load(path: Path, args: FitCommand) -> "Recording":
    """Return a recording with the signals of the catalyst; a log has them as optional ones."""
    from monitor.decode.bus_map import load_pairs
    from monitor.grid.tables import is_table
    from training.greybox.catalyst import NEEDED
    from training.recordings.files.measurement import is_measurement
    from training.recordings.recording import default_pairs, load

    names, pairs = None, args.pairs or default_pairs()
    if not is_table(path) and not is_measurement(path, args.columns):
        bus_map = load_pairs(pairs)
        there = {*bus_map.names, *bus_map.optional}
        names = [name for name in (*NEEDED, "catalyst_temperature_degc") if name in there]
    how: dict[str, Any] = {"channel": args.channel, "columns": args.columns}
    return load(path, names, period_s=args.period, pairs=pairs, **how)


def _print(out: Path, fitted: "FittedCatalyst") -> None:
    """Print the constants with their standard errors."""
    n, error = fitted.samples, fitted.rmse_v
    print(f"{out}: catalyst and downstream sensor, {n} warm samples, voltage within {error:.3f} V")
    for name, row in fitted.constants.items():
        value, std, unit = row["value"], row["standard_error"], row["unit"]
        told = "ended at its bound" if row["at_bound"] else f"± {std:.4f}"
        print(f"constant {name}: {value:.4f} {told} {unit}".rstrip())
