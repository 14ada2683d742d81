"""Subcommand ``o2train calibrate``: the decision limits of a model."""

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

The rate is that of the paper's rule per window of 50 samples, not per drive: the limits keep it
with 95 % confidence, both counting windows as independent and drawing whole drives. A rate of 0.01
needs 299 healthy windows, 517 with --faulty, since the pair of limits is chosen among nine."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``calibrate``; it sets ``func``."""
    parser = subparsers.add_parser(
        "calibrate",
        help="set a model's decision limits for a false-alarm rate",
        description="Set the decision limits of a model from healthy recordings and, where given, "
        "recordings of sensors at the limit severity, and write them into its card.",
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
        help="the model should not have been trained on them",
    )
    parser.add_argument(
        "--faulty",
        type=Path,
        nargs="+",
        default=[],
        metavar="RECORDING",
        help="sensors at the limit severity",
    )
    parser.add_argument(
        "--false-alarms",
        type=float,
        default=0.01,
        metavar="RATE",
        help="most false alarms of the paper's rule per healthy window (default 0.01)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="MODEL.onnx", help="file to write (default: --model itself)"
    )
    parser.add_argument("--config", type=Path, help="TOML that changes shipped settings")
    add_bus_options(parser)
    parser.add_argument("--json", type=Path, metavar="OUT", help="write limits and figures")
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a page")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate and write the card; returns the exit code."""
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
