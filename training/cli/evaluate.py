"""The command ``o2train evaluate``."""

import argparse
from typing import Any

from monitor.base.command_line import option_paths as paths
from training.cli.recordings import add_recordings, load_all

_EXAMPLES = """examples:
  o2train evaluate --model model.onnx drive4.log
  o2train evaluate --model model.onnx drive4.log drive5.log --washout 20 --json figures.json
"""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the command ``evaluate`` to ``subparsers``."""
    evaluate = subparsers.add_parser(
        "evaluate",
        help="predict recordings with a model and report the errors",
        description="Predict every recording by free run of a model and report the errors in the\n"
        "unit of the output.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    evaluate.add_argument(
        "--model",
        type=paths.read,
        required=True,
        metavar="MODEL.onnx",
        help="model file to evaluate",
    )
    add_recordings(evaluate)
    evaluate.add_argument(
        "--washout",
        type=int,
        metavar="N",
        help="number of first samples that set the state from the measured output and are not "
        "scored (default: the longest lag)",
    )
    evaluate.add_argument(
        "--json", type=paths.written, metavar="OUT", help="write the figures as JSON"
    )
    evaluate.set_defaults(func=run)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def run(args: argparse.Namespace) -> int:
    """Predict recordings with a model and return exit code 0.

    Raises UsageError, ModelError or RecordingError (exit code 2).
    """
    from monitor.model.step import Model
    from training.limits.evaluation import evaluate, save

    card = Model.load(args.model).card
    period_s = args.period if args.period is not None else card.period_ns / 1e9
    result = evaluate(args.model, load_all(args, args.recordings, period_s), args.washout)
    for r in result["recordings"]:
        fit = r["fit_percent"]
        simulated = " (simulated)" if r["source"] == "simulated" else ""
        print(
            f"{r['path']}{simulated}: {r['samples']} samples, RMSE {r['rmse']:.4g}, "
            f"fit {'-' if fit is None else f'{fit:.1f} %'}, "
            f"correlation {_number(r['correlation'])}, one-step RMSE {r['one_step_rmse']:.4g}"
        )
        if r["enabled"]:
            e = r["enabled"]
            print(
                f"  enabled: {e['samples']} samples, RMSE {e['rmse']:.4g}, "
                f"correlation {_number(e['correlation'])}"
            )
    if args.json:
        save(result, args.json)
    return 0
