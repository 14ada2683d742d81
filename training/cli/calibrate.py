"""The command ``o2train calibrate``: set the decision limits of a model."""

import argparse
import json
import sys
from typing import Any

from monitor.base.command_line import option_paths as paths
from training.cli.recordings import add_bus_options, load_all

_EXAMPLES = """examples:
  o2train calibrate --model model.onnx --healthy drives/*_healthy.log
  o2train calibrate --model model.onnx --healthy good/*.log --faulty limit/*.log \\
      --false-alarms 0.005 --out calibrated.onnx --report calibration.html

--false-alarms counts windows of 50 samples, not drives, and applies to the paper's rule. The limits
keep this rate with 95 % confidence, by two bounds: one treats all windows as independent, the other
draws whole drives. A rate of 0.01 needs 299 healthy windows. With --faulty it needs 517, because
the command then chooses the limits among nine pairs."""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``calibrate`` to ``subparsers``."""
    parser = subparsers.add_parser(
        "calibrate",
        help="set a model's decision limits for a false-alarm rate",
        description="Set the decision limits of a model and write them into its model file. The\n"
        "limits come from healthy recordings and, optionally, from recordings with a sensor fault\n"
        "at the limit severity.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--model",
        type=paths.read,
        required=True,
        metavar="MODEL.onnx",
        help="model file to calibrate",
    )
    parser.add_argument(
        "--healthy",
        type=paths.read,
        nargs="+",
        required=True,
        metavar="RECORDING",
        help="healthy recordings that the model was not trained on",
    )
    parser.add_argument(
        "--faulty",
        type=paths.read,
        nargs="+",
        default=[],
        metavar="RECORDING",
        help="recordings with a sensor fault at the limit severity (default: none)",
    )
    parser.add_argument(
        "--false-alarms",
        type=float,
        default=0.01,
        metavar="RATE",
        help="highest accepted false-alarm rate of the paper's rule per healthy window, above 0 "
        "and below 0.5 (default 0.01)",
    )
    parser.add_argument(
        "--out",
        type=paths.written_model,
        metavar="MODEL.onnx",
        help="model file to write (default: the file of --model is changed)",
    )
    parser.add_argument("--config", type=paths.read, help="TOML file that changes shipped settings")
    add_bus_options(parser)
    parser.add_argument(
        "--json", type=paths.written, metavar="OUT", help="write the limits and all figures as JSON"
    )
    parser.add_argument("--report", type=paths.written, metavar="HTML", help="write an HTML report")
    parser.set_defaults(func=run, changed_in_place="model")


def run(args: argparse.Namespace) -> int:
    """Calibrate the model, write its card and the reports, and return exit code 0.

    Raises UsageError, ConfigError, ModelError or RecordingError (exit code 2).
    """
    from monitor.base import config
    from monitor.base.errors import UsageError
    from monitor.base.files.outputs import write_text
    from monitor.model.step import Model
    from training.limits.calibration import calibrate
    from training.limits.calibration_page import as_page, as_text
    from training.narx.export import update_card

    out = args.out or args.model
    if out.suffix != ".onnx":
        raise UsageError(f"{out}: a model file ends in .onnx")
    period_s = Model.load(args.model).card.period_ns / 1e9
    card, result = calibrate(
        args.model,
        load_all(args, args.healthy, period_s),
        load_all(args, args.faulty, period_s),
        args.false_alarms,
        config.load(args.config),
    )
    update_card(args.model, card, out)
    for warning in result["warnings"]:
        print(f"o2train: warning: {warning}", file=sys.stderr)
    print(as_text(result))
    if args.json:
        write_text(args.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    if args.report:
        write_text(args.report, as_page(result))
    print(f"limits written to {out}")
    return 0
