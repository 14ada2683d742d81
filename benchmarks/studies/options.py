"""Options of a study's command: one for each field of its plan that has a help text."""

import argparse
import os
from collections.abc import Callable
from dataclasses import MISSING, field, fields
from typing import Any, TypeVar

from monitor.base.command_line import option_paths as paths
from monitor.base.errors import UsageError

Plan = TypeVar("Plan")


def option(default: Any, text: str, read: Callable[[str], Any] | None = None) -> Any:
    """Return a field of a plan that is an option of the command, too.

    A tuple takes several words, a truth value none.
    read : makes the value, or each item of a tuple, from a word; by default the default's type
    """
    return field(default=default, metadata={"help": text, "read": read})


def parser_of(
    name: str, plan: type[Any], about: str | None, run: Callable[[argparse.Namespace], int]
) -> argparse.ArgumentParser:
    """Return the parser of a study: the options of its plan, ``--out`` and ``--jobs``.

    about : description
    run : does the study
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks {name}",
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=paths.folder, metavar="DIR", help="folder for rows and page")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes (all cores)"
    )
    parser.set_defaults(func=run)
    for each in fields(plan):
        if "help" in each.metadata:
            _add(parser, each.name, each.default, each.type, each.metadata)
    return parser


def _add(parser: argparse.ArgumentParser, name: str, default: Any, kind: Any, about: Any) -> None:
    flag, text = f"--{name.replace('_', '-')}", about["help"]
    if isinstance(default, bool):
        parser.add_argument(flag, action="store_true", help=text)
        return
    many = isinstance(default, tuple)
    read = about["read"] or (str if many else type(default))
    told = "" if many or default is MISSING else f" (default {default})"
    parser.add_argument(
        flag,
        type=read,
        default=default,
        nargs="+" if many else None,
        help=text + told,
        metavar=name[0].upper(),
    )


def plan_of(plan: type[Plan], args: argparse.Namespace) -> Plan:
    """Return the plan of the options; raises UsageError if there is no place or no process."""
    if args.out is None:
        raise UsageError("--out DIR is needed")
    if args.jobs < 1:
        raise UsageError(f"--jobs is at least 1, not {args.jobs}")
    own = [each.name for each in fields(plan) if "help" in each.metadata]
    given = {name: getattr(args, name) for name in own}
    return plan(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})
