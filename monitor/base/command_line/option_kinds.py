"""The kinds of input that an option acts on: one that would do nothing with its input is refused.

``ActsOn`` in the type of a parameter says so. The input of a command are the options whose role is
``recording``; without any it is a bus.
"""

import argparse
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

from monitor.base.command_line.option_paths import named, recording
from monitor.base.errors import UsageError

LOG: Final = "a CAN log"
TABLE: Final = "a table"
BUS: Final = "a bus"
KindsOf = Callable[[Path], Collection[str]]


class ActsOn(tuple[str, ...]):
    """The kinds of input that an option acts on, such as ``ActsOn([LOG, BUS])``."""

    __slots__ = ()

    def mark(self, action: argparse.Action) -> None:
        """Let an option of a parser act on these kinds only."""
        vars(action)["acts_on"] = self


def check(parser: argparse.ArgumentParser, args: argparse.Namespace, kinds_of: KindsOf) -> None:
    """Raise UsageError for an option of the chosen command that does nothing with its input.

    kinds_of : returns what a recording may be
    """
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            check(action.choices[str(getattr(args, action.dest))], args, kinds_of)
    given = [a for a in parser._actions if hasattr(a, "acts_on") and _is_given(a, args)]
    paths = [each.path for each in named(parser, args) if each.role is recording]
    has_input = any(action.type is recording for action in parser._actions)
    if not (given and has_input and all(map(Path.is_file, paths))):  # the command names it
        return
    kinds = {kind for path in paths for kind in kinds_of(path)} or {BUS}
    for action in given:
        if not kinds.intersection(action.acts_on):
            names, wanted = "/".join(action.option_strings), " or ".join(action.acts_on)
            raise UsageError(f"{names} is for {wanted}, not for {' or '.join(sorted(kinds))}")


def _is_given(action: argparse.Action, args: argparse.Namespace) -> bool:
    return bool(getattr(args, action.dest, action.default) != action.default)
