"""Make the shell completions from the parsers of the commands, with shtab.

    python share/completions.py    writes share/bash-completion, share/zsh

The files lie in the repository, because a wheel is built without the packages that the parsers
need. A test compares them with what this program makes.
"""

import argparse
import sys
from pathlib import Path
from typing import Final

import shtab

from monitor.cli import _parser as o2mon_parser
from training.cli import _parser as o2train_parser

SHARE: Final = Path(__file__).resolve().parent


def files() -> dict[Path, str]:
    """Return path, relative to ``share``, and content of every generated file."""
    made = {}
    for name, parser in (("o2mon", o2mon_parser(None)), ("o2train", o2train_parser(None))):
        tidy(parser)
        made[Path(f"bash-completion/completions/{name}")] = shtab.complete(parser, "bash")
        made[Path(f"zsh/site-functions/_{name}")] = shtab.complete(parser, "zsh")
    return made


def tidy(parser: argparse.ArgumentParser) -> None:
    """Let file options complete file names; interfaces differ between installations."""
    for action in parser._actions:
        is_argument = not action.choices and not action.option_strings
        module = getattr(action.type, "__module__", "")
        names_file = module == "monitor.base.command_line.option_paths"
        if is_argument or names_file:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                tidy(command)


def main() -> int:
    """Write every file."""
    for path, text in files().items():
        place = SHARE / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
        print(place.relative_to(SHARE.parent))
    return 0


if __name__ == "__main__":
    sys.exit(main())
