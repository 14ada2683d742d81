"""The command ``o2train``."""

import argparse
import os
import sys
from collections.abc import Sequence

from monitor.base.errors import O2Error

USAGE_ERROR, INTERNAL_ERROR, INTERRUPTED, BROKEN_PIPE = 2, 4, 130, 141


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command ``o2train`` and return its exit code.

    Exit codes: 0 done, 2 the user can correct the error, 4 internal error, 130 interrupted, 141
    broken pipe. A command documents further codes.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # two BLAS threads are slower than one here
    try:
        args = _parser().parse_args(argv)
        return int(args.func(args))
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except Exception as error:
        reason = _users_part(error)
        if reason is None and os.environ.get("O2_TRACEBACK"):
            raise
        text = reason or f"internal error: {type(error).__name__}: {error}"
        print(f"o2train: {text}", file=sys.stderr)
        return USAGE_ERROR if reason else INTERNAL_ERROR


def _users_part(error: Exception) -> str | None:
    """Return the message for an error that the user can correct, None for a bug."""
    if isinstance(error, O2Error):
        return str(error)
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").split(".")[0]
        if package not in ("monitor", "training", "dbc"):
            return f"{package} is not installed: pip install 'o2-monitor[training]'"
    if isinstance(error, OSError):
        return f"{error.filename or 'file'}: {error.strerror or error}"
    return None


def _parser() -> argparse.ArgumentParser:
    from monitor import __version__
    from training.cli import (
        calibrate,
        check,
        fleet,
        gap,
        gap_study,
        model,
        recordings,
        simulate,
        study,
    )

    parser = argparse.ArgumentParser(
        prog="o2train", description="Recordings, models and limits for the oxygen sensor monitor."
    )
    parser.add_argument("--version", action="version", version=f"o2train {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")
    modules = (simulate, recordings, check, model, calibrate, study)
    for module in (*modules, gap, gap_study, fleet):
        module.add_parsers(commands)
    return parser
