"""Make man pages and shell completions from the parsers of the commands.

    python share/generate.py    writes share/man, share/bash-completion, share/zsh

The files lie in the repository, because a wheel is built without the packages that the parsers
need. A test compares them with what this program makes. Completions come from shtab.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import shtab

from monitor.base import verbosity
from monitor.cli import _parser as o2mon_parser
from training.cli import _parser as o2train_parser

SHARE: Final = Path(__file__).resolve().parent
SEE_ALSO: Final = {"o2mon": "o2train", "o2train": "o2mon"}
LONG_CHOICE: Final = 8  # more choices than this depend on what is installed, or fill a screen


def files() -> dict[Path, str]:
    """Return path, relative to ``share``, and content of every generated file."""
    made = {}
    for name, parser in (("o2mon", o2mon_parser(None)), ("o2train", o2train_parser())):
        verbosity.add_options(parser)
        made[Path(f"man/man1/{name}.1")] = man_page(parser)
        tidy(parser)
        bash = shtab.complete(parser, "bash")
        made[Path(f"bash-completion/completions/{name}")] = bash
        made[Path(f"zsh/site-functions/_{name}")] = shtab.complete(parser, "zsh")
    return made


def commands(
    parser: argparse.ArgumentParser,
) -> Iterator[tuple[argparse.ArgumentParser, str]]:
    """Yield each command with its one line of help, in the order of ``--help``."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: choice.help or "" for choice in action._choices_actions}
            for name, command in action.choices.items():
                yield command, helps.get(name, "")


def tidy(parser: argparse.ArgumentParser) -> None:
    """Let file options complete file names; interfaces differ between installations."""
    for action in parser._actions:
        is_argument = not action.choices and not action.option_strings
        names_file = getattr(action.type, "__module__", "") == "monitor.base.option_paths"
        if is_argument or names_file:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    for command, _ in commands(parser):
        tidy(command)


def man_page(parser: argparse.ArgumentParser) -> str:
    """Return the man page of a program with all its commands."""
    name = parser.prog
    about = parser.description or ""
    lines = [
        f'.TH {name.upper()} 1 "" "o2-monitor" "User Commands"',
        ".SH NAME",
        f"{name} \\- {roff(about).rstrip('.').lower()}",
        ".SH SYNOPSIS",
        f".B {name}",
        ".I command",
        "[options]",
        ".br",
        f".B {name}",
        "\\-\\-version",
        ".SH DESCRIPTION",
        roff(about),
        ".SH COMMANDS",
    ]
    for command, help_line in commands(parser):
        lines += section(command, help_line)
    lines += [
        ".SH EXIT STATUS",
        "0 done, or judged without a fault; 1 a fault code; 2 unusable input; 3 not judged;",
        "4 internal error; 130 interrupted.",
        ".SH SEE ALSO",
        f".BR {SEE_ALSO[name]} (1)",
    ]
    return "\n".join(lines) + "\n"


def section(command: argparse.ArgumentParser, help_line: str) -> list[str]:
    """Return a command's part of the page, with those of its own commands."""
    lines = [f".SS {roff(command.prog)}", roff(help_line or command.description or "")]
    for action in command._actions:
        if isinstance(action, argparse._SubParsersAction | argparse._HelpAction):
            continue
        lines += [".TP", head(action), roff(action.help or "")]
    if command.epilog:
        lines += [".PP", ".nf", *(roff(line) for line in command.epilog.splitlines()), ".fi"]
    for inner, inner_help in commands(command):
        lines += section(inner, inner_help)
    return lines


def head(action: argparse.Action) -> str:
    """Return option strings and value of an option, or the name of an argument."""
    value = action.metavar or action.dest.upper()
    if isinstance(value, tuple):
        value = " ".join(value)
    if action.choices and len(list(action.choices)) <= LONG_CHOICE and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    if action.nargs in ("*", "+"):
        value += " ..."
    if not action.option_strings:
        return f".I {roff(value)}"
    takes = "" if action.nargs == 0 else f" \\fI{roff(value)}\\fR"
    return "\\fB" + "\\fR, \\fB".join(map(roff, action.option_strings)) + f"\\fR{takes}"


def roff(text: str) -> str:
    """Return a text for troff: backslashes, hyphens and leading dots are escaped."""
    text = text.replace("%%", "%").replace("\\", "\\e").replace("-", "\\-")
    text = "".join(c if c.isascii() else f"\\[u{ord(c):04X}]" for c in text)
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.M)


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
