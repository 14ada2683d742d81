"""Subcommand ``o2train gap``: find, name and add the effect that a model lacks."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from training.cli.recordings import add_bus_options, add_period_option, load_all

if TYPE_CHECKING:
    from training.gap.inputs.roles import Given, Options
    from training.gap.result import Result

REPORT, RESULT, STAGES = "report.html", "gap.json", "stages"
_EXAMPLES = """examples:
  o2train gap --model chain.onnx new1.log new2.log new3.log --healthy old*.log --out gap
  o2train gap --model model.onnx new*.parquet --healthy old*.parquet --out gap --steps 3
  o2train gap --model chain.onnx new*.log --healthy old*.log --out gap --add exhaust_leak
  o2train gap --model chain.onnx new*.csv --healthy old*.csv --columns channels.toml --out gap

Needed signals: fuel_mass_mg, lambda_measured, and air_mass_mg (or maf_kg_h with engine_speed_rpm).
docs/signals.md lists the names and units of all signals.
"""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``gap``."""
    gap = subparsers.add_parser(
        "gap",
        help="find the effect that a model lacks on a healthy vehicle, and add it",
        description="Find where model and recordings disagree, name the effect that explains it, "
        "and add the effect to a new model. The new model is verified on recordings that no fit "
        "used. Give several recordings of ten minutes each, of mixed driving, with the gap and "
        "without. To continue a stopped run, give the same command again.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    gap.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="recording of a healthy vehicle on which the model is wrong",
    )
    gap.add_argument("--model", type=Path, required=True, metavar="MODEL.onnx")
    gap.add_argument(
        "--healthy",
        nargs="+",
        type=Path,
        default=[],
        metavar="RECORDING",
        help="recordings of the same vehicle without the gap, usually those on which the model was "
        "accepted (default: the reference that o2train fit stored in the model; without any "
        "reference, a weakness of the model cannot be told from an effect)",
    )
    gap.add_argument(
        "--verify",
        nargs="+",
        type=Path,
        default=[],
        metavar="RECORDING",
        help="recordings that verify the new model and are used by no fit; they also choose "
        "between models when a network is retrained, or when the model was trained on the "
        "RECORDINGs (default: every third RECORDING, which the naming uses, too)",
    )
    gap.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for report.html, gap.json and model.onnx",
    )
    gap.add_argument(
        "--steps",
        type=int,
        default=1,
        metavar="N",
        help="most effects to add, one after the other: 1 to 3 (default: 1)",
    )
    gap.add_argument(
        "--sensor-known-good",
        action="store_true",
        help="the sensor was checked: do not consider sensor faults",
    )
    gap.add_argument(
        "--add",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="effects, such as exhaust_leak, that may be faults but are known to be none here",
    )
    gap.add_argument(
        "--retrain",
        type=float,
        default=3.0,
        metavar="MIN",
        help="minutes for retraining a network with the effect as an input, also on the "
        "healthy recordings; the better model is kept (default: 3; 0 does not retrain)",
    )
    add_period_option(gap)
    add_bus_options(gap)
    gap.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the gap workflow and write its result; return the exit code."""
    from tqdm import tqdm

    from monitor.base.outputs import check
    from training.gap.inputs.roles import Given, options_of
    from training.gap.pages import report
    from training.gap.pages.report_words import cautions
    from training.gap.result import save
    from training.gap.workflow import NEW_MODEL, investigate
    from training.jobs.stages import Stages

    check((args.out / NEW_MODEL,) if args.out.is_dir() else (), (args.model,))
    options = options_of(args.steps, args.sensor_known_good, _effects(args.add), args.retrain)
    period_s = args.period if args.period is not None else _period_s(args.model)
    given = Given(
        args.model,
        *(load_all(args, each, period_s) for each in (args.recordings, args.healthy, args.verify)),
    )
    args.out.mkdir(parents=True, exist_ok=True)
    stages = Stages.of(args.out / STAGES, _identity(given, options))
    with tqdm(unit="step", leave=False, disable=None) as bar:

        def progress(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        found = investigate(given, args.out, options, stages=stages, progress=progress)
    of_before = args.out / NEW_MODEL
    if found.new_model is None:
        of_before.unlink(missing_ok=True)
    for warning in cautions(found):
        print(f"o2train: warning: {warning}", file=sys.stderr)
    save(found, args.out / RESULT)
    report.save(found, args.out / REPORT)
    stages.clear()
    _print(found, args.out)
    return 0


def _period_s(model: Path) -> float:
    from training.gap.inputs.base import check

    return check(model).period_ns / 1e9


def _effects(names: list[str]) -> list[str]:
    from monitor.base.errors import UsageError
    from training.greybox.effects import LIBRARY

    for name in names:
        if name not in LIBRARY:
            raise UsageError(f"effect {name!r} is unknown; there are {', '.join(LIBRARY)}")
    return names


def _identity(given: "Given", options: "Options") -> dict[str, Any]:
    """Return everything that the results depend on, to recognise a run that can be continued."""
    from training import __file__ as package
    from training.jobs.run_folder import code_sha256
    from training.recordings.recording import sha256

    root = Path(package).parent
    return {
        "model": sha256(given.model),
        "options": repr(options),
        "code": code_sha256([*root.rglob("*.py")], root),
        **{
            each: [(r.path.name, r.read_sha256) for r in getattr(given, each)]
            for each in ("recordings", "healthy", "verify")
        },
    }


def _print(found: "Result", out: Path) -> None:
    from training.gap.name.decision import T_LEAST
    from training.gap.pages.report_words import verdict_sentence

    print(verdict_sentence(found))
    before, after, floor, measured_on = found.rmse
    then = "" if after is None else f", {after:.4f} after"
    print(f"RMSE in phi on {measured_on}: {before:.4f} before{then}, noise floor {floor:.4f}")
    for candidate in found.naming.ranking[:5]:
        print(
            f"  {candidate.name}: score {candidate.score:.0f} ({candidate.needed:.0f} needed), "
            f"t {candidate.t:.1f} ({T_LEAST:.0f} needed)"
            + ("" if candidate.physical else ", with constants that it cannot have")
        )
    if found.naming.experiment is not None:
        print(f"to tell them apart: {found.naming.experiment}")
    if found.unknown:
        print(found.unknown)
    if found.new_model is not None:
        print(f"model: {found.new_model}")
    print(f"report: {out / REPORT}")
