"""``o2train gap``: what the model lacks, its name, a model that has it, and a report."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from training.cli.recordings import add_bus_options, add_period_option, load_all

if TYPE_CHECKING:
    from training.gap.inputs.roles import Material, Options
    from training.gap.result import Result

REPORT, RESULT, STAGES = "report.html", "gap.json", "stages"
_EXAMPLES = """examples:
  o2train gap --model chain.onnx new1.log new2.log new3.log --healthy old*.log --out gap
  o2train gap --model model.onnx new*.parquet --healthy old*.parquet --out gap --steps 3
  o2train gap --model chain.onnx new*.log --healthy old*.log --out gap --add exhaust_leak
  o2train gap --model chain.onnx new*.csv --healthy old*.csv --columns channels.toml --out gap

needed are fuel_mass_mg, lambda_measured and air_mass_mg (or maf_kg_h with engine_speed_rpm);
names and units of all signals: docs/reference/signals.md
"""


def add_parsers(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add the subcommand ``gap``; it sets ``func``."""
    gap = subparsers.add_parser(
        "gap",
        help="find what a model lacks on a healthy vehicle, name it and add it",
        description="Where the model and the recordings disagree, which effect explains it, and "
        "a new model that has the effect, verified on recordings that no fit saw. Several "
        "recordings of ten minutes each, of mixed driving, are wanted on either side. A run that "
        "was stopped goes on when it is begun again.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    gap.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="of a healthy vehicle on which the model disagrees",
    )
    gap.add_argument("--model", type=Path, required=True, metavar="MODEL.onnx")
    gap.add_argument(
        "--healthy",
        nargs="+",
        type=Path,
        default=[],
        metavar="RECORDING",
        help="of the same vehicle without the gap, as a rule those on which the "
        "model was accepted: without them the reference that fit left in the model "
        "serves; if it has none, a weakness of the model itself cannot be told from "
        "an effect",
    )
    gap.add_argument(
        "--verify",
        nargs="+",
        type=Path,
        default=[],
        metavar="RECORDING",
        help="on which the new model is verified and which no fit sees; they also "
        "say what is better where a network is trained anew or the model knows the "
        "others (default: every third RECORDING, which the naming sees, "
        "too)",
    )
    gap.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of report.html, gap.json and model.onnx",
    )
    gap.add_argument(
        "--steps",
        type=int,
        default=1,
        metavar="N",
        help="effects to add at most, one after the other: 1 (default) to 3",
    )
    gap.add_argument(
        "--sensor-known-good",
        action="store_true",
        help="the sensor was checked: explain nothing by its faults",
    )
    gap.add_argument(
        "--add",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="effects that may be faults and are known to be none, such as exhaust_leak",
    )
    gap.add_argument(
        "--retrain",
        type=float,
        default=3.0,
        metavar="MIN",
        help="minutes to train a network anew with the effect as an input, on the "
        "healthy recordings, too; the better of both ways is kept (default 3, 0 is "
        "none)",
    )
    add_period_option(gap)
    add_bus_options(gap)
    gap.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Look for the gap and write what was found; returns the exit code."""
    from tqdm import tqdm

    from monitor.base.outputs import check
    from training.gap.inputs.roles import Material, options_of
    from training.gap.pages import gap_page
    from training.gap.pages.verdict_words import cautions
    from training.gap.result import save
    from training.gap.workflow import NEW_MODEL, investigate
    from training.jobs.checkpoints import Checkpoints

    check((args.out / NEW_MODEL,) if args.out.is_dir() else (), (args.model,))
    options = options_of(args.steps, args.sensor_known_good, _effects(args.add), args.retrain)
    period_s = args.period if args.period is not None else _period_s(args.model)
    material = Material(
        args.model,
        *(load_all(args, each, period_s) for each in (args.recordings, args.healthy, args.verify)),
    )
    args.out.mkdir(parents=True, exist_ok=True)
    stages = Checkpoints.of(args.out / STAGES, _identity(material, options))
    with tqdm(unit="step", leave=False, disable=None) as bar:

        def progress(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        found = investigate(material, args.out, options, stages=stages, progress=progress)
    of_before = args.out / NEW_MODEL
    if found.new_model is None:
        of_before.unlink(missing_ok=True)
    for warning in cautions(found):
        print(f"o2train: warning: {warning}", file=sys.stderr)
    save(found, args.out / RESULT)
    gap_page.save(found, args.out / REPORT)
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


def _identity(material: "Material", options: "Options") -> dict[str, Any]:
    """Return what the results depend on."""
    from training import __file__ as package
    from training.jobs.run_folder import code_sha256
    from training.recordings.recording import sha256

    root = Path(package).parent
    return {
        "model": sha256(material.model),
        "options": repr(options),
        "code": code_sha256([*root.rglob("*.py"), *root.rglob("*.toml")], root),
        **{
            each: [(r.path.name, r.read_sha256) for r in getattr(material, each)]
            for each in ("recordings", "healthy", "verify")
        },
    }


def _print(found: "Result", out: Path) -> None:
    from training.gap.name.decision import T_LEAST
    from training.gap.pages.verdict_words import verdict_sentence

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
