"""Subcommand ``o2train calibrate``: set the decision limits of a model."""

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from training.cli.recordings import add_bus_options, load_all

_EXAMPLES = """examples:
  o2train calibrate --model model.onnx --healthy drives/*_healthy.log
  o2train calibrate --model model.onnx --healthy good/*.log --faulty limit/*.log \\
      --false-alarms 0.005 --out calibrated.onnx --report calibration.html

RATE is the false-alarm rate of the paper's rule per window of 50 samples, not per drive. The limits
keep it with 95 % confidence, for independent windows and for resampled whole drives alike. A rate
of 0.01 needs 299 healthy windows, with --faulty 517, because one of nine limit pairs is chosen."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``calibrate``."""
    parser = subparsers.add_parser(
        "calibrate",
        help="set a model's decision limits for a false-alarm rate",
        description="Set a model's decision limits from healthy recordings and, if there are any, "
        "from recordings of sensors at the limit severity. The limits are stored in its card.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.onnx")
    parser.add_argument(
        "--healthy",
        type=Path,
        nargs="+",
        required=True,
        metavar="RECORDING",
        help="healthy recordings, if possible not used in training",
    )
    parser.add_argument(
        "--faulty",
        type=Path,
        nargs="+",
        default=[],
        metavar="RECORDING",
        help="recordings of sensors at the limit severity",
    )
    parser.add_argument(
        "--false-alarms",
        type=float,
        default=0.01,
        metavar="RATE",
        help="most false alarms of the paper's rule per healthy window (default: 0.01)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="MODEL.onnx", help="model to write (default: change --model)"
    )
    parser.add_argument("--config", type=Path, help="TOML file that changes the shipped settings")
    add_bus_options(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write limits and figures as JSON")
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a report")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate and write the card; return the exit code."""
    from monitor.base import config
    from monitor.base.errors import UsageError
    from monitor.model.step import Model
    from training.limits.calibration import calibrate
    from training.limits.calibration_page import as_page, as_text
    from training.narx.export import update_card

    out = args.out or args.model
    if out.suffix != ".onnx":
        raise UsageError(f"{out}: a model file ends in .onnx")
    for path in (out, args.json, args.report):
        if path is not None and not path.absolute().parent.is_dir():
            raise UsageError(f"{path}: the folder does not exist")
    period_s = Model.load(args.model).card.period_ns / 1e9
    card, result = calibrate(
        args.model,
        load_all(args, args.healthy, period_s),
        load_all(args, args.faulty, period_s),
        args.false_alarms,
        config.load(args.config),
    )
    if out.absolute() != args.model.absolute():
        shutil.copyfile(args.model, out)
    update_card(out, card)
    for warning in result["warnings"]:
        print(f"o2train: warning: {warning}", file=sys.stderr)
    print(as_text(result))
    if args.json:
        args.json.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
    if args.report:
        args.report.write_text(as_page(result))
    print(f"limits written to {out}")
    return 0
