"""Subcommand ``o2train simulate``: drives of the simulated vehicle as logs or tables."""

import argparse
from pathlib import Path
from typing import Any

from monitor.base.errors import UsageError

_EXAMPLES = """examples:
  o2train simulate --out drives                               healthy WLTC of vehicle 1
  o2train simulate --out drives --cycle udds --seed 7 --format parquet
  o2train simulate --out drives --fault delay_rich_to_lean=0.6 --vehicle 12
  o2train simulate --out drives --effect wall_film=4 --effect purge=2 --count 20

All output is synthetic. The vehicle number chooses the piece; the seed chooses driver, noise and
weather. The same call gives the same bytes, except the clock time in .asc and the path in .trc."""
FORMATS = ("log", "blf", "asc", "trc", "mf4", "parquet", "csv", "csv.gz")


def add_parsers(commands: Any) -> None:
    """Add the subcommand ``simulate``."""
    from monitor.base import faults
    from training.dyno import effects

    parser = commands.add_parser(
        "simulate",
        help="drive the simulated vehicle",
        description="Drive the simulated vehicle on a chassis dynamometer.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    parser.add_argument("--vehicle", type=int, default=1, help="number of the piece (default: 1)")
    parser.add_argument(
        "--cycle",
        default="wltc_3b",
        help="wltc_3b (default), udds, us06, hwfet, micro_trips or steady",
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[=SEVERITY]",
        help=f"sensor fault inside the control loop: {', '.join(faults.NAMES)}; severity in s, "
        "as a gain, or in lambda; may repeat",
    )
    parser.add_argument(
        "--fault-start",
        type=float,
        default=0.0,
        metavar="S",
        help="start of the fault in s (default: 0)",
    )
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME=SEVERITY",
        help=f"effect; severity 1 is about the noise; may repeat: {', '.join(effects.NAMES)}",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the first drive (default: 1)")
    parser.add_argument(
        "--count", type=int, default=1, help="number of drives; seeds count up (default: 1)"
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="length in s (default: the whole cycle)"
    )
    parser.add_argument(
        "--period", type=float, default=0.1, metavar="S", help="grid of a table in s (default: 0.1)"
    )
    parser.add_argument("--format", choices=FORMATS, default="log", help="format (default: log)")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Simulate and write the drives; print their paths; return the exit code."""
    from tqdm import tqdm

    from monitor.base import faults
    from training.dyno import effects
    from training.dyno.recording_files import write
    from training.dyno.simulation import Experiment

    if args.count < 1 or not args.period >= 0.01:
        raise UsageError("--count is at least 1, --period at least 0.01 s")
    if min(args.seed, args.vehicle) < 0:
        raise UsageError("--seed and --vehicle are at least 0")
    if args.duration is not None and not 0.0 < args.duration < float("inf"):
        raise UsageError(f"--duration {args.duration:g}: a positive number is wanted")
    if not 0.0 <= args.fault_start < (args.duration or float("inf")):
        raise UsageError(f"--fault-start {args.fault_start:g}: not within the drive")
    fault = faults.combine([faults.resolve(*pair) for pair in map(_fault, args.fault)])
    hidden = effects.from_severities(dict(map(_severity, args.effect)))
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{args.out}: {error.strerror}") from None
    seeds = range(args.seed, args.seed + args.count)
    for seed in tqdm(seeds, unit="drive", disable=args.count == 1):
        experiment = Experiment(
            cycle=args.cycle,
            vehicle=args.vehicle,
            seed=seed,
            fault=fault,
            fault_start_s=args.fault_start,
            effects=hidden,
            duration_s=args.duration,
        )
        print(write(experiment, args.out, args.format, args.period))
    return 0


def _fault(text: str) -> tuple[str, float | None]:
    return _severity(text) if "=" in text else (text, None)


def _severity(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise UsageError(f"{text!r}: wanted NAME=SEVERITY") from None
