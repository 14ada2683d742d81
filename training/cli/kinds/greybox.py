"""The grey-box part of ``o2train fit``: check options, fit the chain, print its constants."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from training.cli.kinds.fit_command import FitCommand

if TYPE_CHECKING:
    from training.greybox.model import GreyboxResult
    from training.recordings.recording import Recording


def check(args: FitCommand) -> None:
    """Raise UsageError if an option is set that only a NARX has."""
    from monitor.base.errors import UsageError

    is_set = {
        "--lags": args.lags is not None,
        "--lag-zero": args.lag_zero,
        "--hidden": args.hidden is not None,
        "--starts": args.starts is not None,
        "--budget": args.budget != FitCommand.budget,
        "--wall": args.wall is not None,
    }
    wrong = [option for option, value in is_set.items() if value]
    if wrong:
        raise UsageError(f"{', '.join(wrong)}: a grey-box model has no such thing, a NARX has")


def fit(args: FitCommand, recordings: "list[Recording]") -> "GreyboxResult":
    """Fit the constants of the chain, write the model file and return the result.

    Raises RecordingError if the recordings cannot hold a fit.
    """
    from monitor.base.signals import OUTPUT
    from training.cli.console.share_bar import Share
    from training.greybox.model import fit_greybox

    with Share("grey-box fit") as bar:
        return fit_greybox(
            recordings,
            args.out,
            inputs=args.inputs,
            output=args.output or OUTPUT,
            seed=args.seed,
            progress=bar.update,
        )


def print_fit(result: "GreyboxResult") -> None:
    """Print the constants of the chain with their standard errors."""
    n = len(result.data.role)
    print(f"{result.path}: {n} samples, grey-box chain, {result.seconds:.0f} s")
    for name, constant in result.card.structure["constants"].items():
        print(constant_line(name, constant))
    for effect in result.greybox.own:
        print(f"healthy vehicle's {effect.in_words}")


def constant_line(name: str, constant: Mapping[str, Any]) -> str:
    """Return one line of text for a constant of the model card, with its unit and error."""
    value, error, unit = (constant[key] for key in ("value", "standard_error", "unit"))
    if error > abs(value):
        return f"constant {name}: {value:.4f} {unit} (the recordings hardly hold it)"
    return f"constant {name}: {value:.4f} ± {error:.4f} {unit}"
