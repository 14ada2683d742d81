"""The command ``o2train``."""

import argparse
import os
import sys
from collections.abc import Sequence

from monitor.errors import O2Error

USAGE_ERROR, INTERNAL_ERROR, BROKEN_PIPE = 2, 4, 141


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``o2train``; return the exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # two BLAS threads are slower than one here
    try:
        args = _parser().parse_args(argv)
        return int(args.func(args))
    except O2Error as error:
        print(f"o2train: {error}", file=sys.stderr)
        return USAGE_ERROR
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        print(f"o2train: {error.filename or ''}: {error.strerror or error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        if os.environ.get("O2_TRACEBACK"):
            raise
        print(f"o2train: internal error: {type(error).__name__}: {error}", file=sys.stderr)
        return INTERNAL_ERROR


def _parser() -> argparse.ArgumentParser:
    from monitor import __version__
    from training import cli_model, cli_recordings, cli_simulate

    parser = argparse.ArgumentParser(
        prog="o2train", description="Recordings, models and limits for the oxygen sensor monitor."
    )
    parser.add_argument("--version", action="version", version=f"o2train {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")
    for module in (cli_simulate, cli_recordings, cli_model):
        module.add_parsers(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
