"""How much a command says: ``-q`` and ``-v`` of every command of ``o2mon`` and ``o2train``.

``-q`` prints nothing but errors; files and exit code stay as they are. A command whose ``-q``
leaves something, such as the final verdict, declares ``--quiet`` itself. ``-v`` adds lines on the
standard error: versions, files that are read, warnings of libraries, duration; ``-vv`` whatever
libraries log.
"""

import argparse
import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Final

LOG: Final = logging.getLogger("o2_monitor")
PACKAGES: Final = ("o2-monitor", "numpy", "python-can", "cantools", "onnxruntime")
_LEVELS: Final = (logging.WARNING, logging.INFO, logging.DEBUG)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add ``-q`` and ``-v`` to a parser, or to each of its subcommands."""
    inner = [each for each in parser._actions if isinstance(each, argparse._SubParsersAction)]
    for commands in inner:
        for command in commands.choices.values():
            add_options(command)
    if inner:
        return
    if "--quiet" not in parser._option_string_actions:
        parser.add_argument(
            "-q", "--quiet", action="store_true", dest="nothing", help="print nothing but errors"
        )
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="say versions, files and duration on the standard error; twice: all that is logged",
    )


@contextmanager
def applied(args: argparse.Namespace) -> Iterator[None]:
    """Let the command say as much as its options ask for."""
    verbose = min(args.verbose, len(_LEVELS) - 1)
    if not verbose:
        with _silent(args):
            yield
        return
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    root, before = logging.getLogger(), logging.getLogger().level
    root.addHandler(handler)
    root.setLevel(_LEVELS[verbose])
    begin_s = time.perf_counter()
    if LOG.isEnabledFor(logging.INFO):
        LOG.info("%s", ", ".join(_versions()))
    try:
        with _silent(args):
            yield
    finally:
        LOG.info("took %.2f s", time.perf_counter() - begin_s)
        root.removeHandler(handler)
        root.setLevel(before)


@contextmanager
def _silent(args: argparse.Namespace) -> Iterator[None]:
    """Send the standard output of a command that is to print nothing to nowhere."""
    if not getattr(args, "nothing", False):
        yield
        return
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
        yield


def _versions() -> Iterator[str]:
    import platform  # noqa: PLC0415 - slow, and of no use without -v
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    yield f"Python {platform.python_version()}"
    yield f"{platform.system()} {platform.machine()}"
    for package in PACKAGES:
        try:
            yield f"{package} {version(package)}"
        except PackageNotFoundError:
            yield f"{package} missing"
