"""All commands of both programs, as their parsers have them."""

import argparse
from collections.abc import Iterator
from typing import Any

from monitor import cli as o2mon
from training import cli as o2train

PROGRAMS = ("o2mon", "o2train")


def parser_of(program: str, command: str) -> argparse.ArgumentParser:
    """Return a program's parser with the options of a command."""
    return (o2mon if program == "o2mon" else o2train)._parser([command])


def command_names(program: str) -> list[str]:
    """Return the commands of a program."""
    (branch,) = _branches(parser_of(program, ""))
    return list(branch.choices)


def _branches(parser: argparse.ArgumentParser) -> list[Any]:
    return [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]


def commands(
    parser: argparse.ArgumentParser, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    """Yield the words and the parser of every command, of actions of commands too."""
    branches = _branches(parser)
    for branch in branches:
        for name, below in branch.choices.items():
            yield from commands(below, (*words, name))
    if not branches:
        yield words, parser


def options(parser: argparse.ArgumentParser, role: Any) -> list[argparse.Action]:
    """Return the options of a command whose paths have a role."""
    return [action for action in parser._actions if action.type is role]


def words_of(parser: argparse.ArgumentParser, chosen: dict[str, str]) -> list[str]:
    """Return a command line with the options chosen and all that are required.

    chosen : value by the option's name in the namespace
    """
    words: list[str] = []
    positional: list[str] = []
    left = dict(chosen)  # two options may fill one name, one of them is given
    for action in parser._actions:
        if action.dest in left:
            value = left.pop(action.dest)
        elif action.dest not in chosen and action.required and action.nargs not in ("?", "*"):
            value = f"/nowhere/{action.dest}"
        else:
            continue
        if action.option_strings:
            words += [action.option_strings[-1], value]
        else:
            positional.append(value)
    return [*positional, *words]
