"""The files that a command reads and writes: every option that names a file says which it does.

The ``type`` of an argparse option is its role here. ``check`` looks at all options of the chosen
command before the work begins: nothing that is read is written over, nothing is written twice, no
file of another program is replaced without ``--force``, an option that every command that writes
has. Files that a command writes without an option of their own are named by
``also_written``, a default of the parser: a function from the namespace to paths; ``appended``
names those that it lengthens. A command that changes a file in place unless it is told to write
another names that option ``changed_in_place``.
"""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from monitor.base.errors import UsageError
from monitor.base.files import manifest, outputs
from monitor.base.files.inputs import other_kind

FACTS: Final = ("also_written", "appended", "changed_in_place")


class PathRole:
    """What a command does with an option's file; as the option's ``type`` it makes the path."""

    def __call__(self, text: str) -> Path:
        """Return the path."""
        return Path(text)


read = PathRole()  # a file that the command only reads
recording = PathRole()  # a drive that it only reads
written = PathRole()  # that it writes anew
numbered = PathRole()  # to write; if it exists, the command adds a number to its name
written_model = PathRole()  # a model to write; it may take the place of the shipped model
folder = PathRole()  # into which the command writes
kept = PathRole()  # a fault memory, which it reads and goes on writing


def pattern(text: str) -> str:
    """Return a path, pattern or URL of recordings to read; its command finds the files."""
    return text


class Named(NamedTuple):
    """A path that the user gave."""

    role: PathRole
    option: str  # name in the namespace
    path: Path


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add ``--force`` to the options of a command that writes files."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for each in action.choices.values():
                add_force(each)
    roles = {action.type for action in parser._actions}
    if roles & {written, written_model} or parser.get_default("also_written"):
        text = "replace files that this program did not write, too"
        parser.add_argument("--force", action="store_true", help=text)


def check(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Check the files of the chosen command's options; raises UsageError for the first conflict."""
    found = list(named(parser, args))

    def of(*roles: PathRole) -> list[Path]:
        return [each.path for role in roles for each in found if each.role is role]

    memories, readable = of(kept), (read, recording)
    for path in of(*readable, kept):
        if path.exists() and (kind := other_kind(path.stat().st_mode)):
            raise UsageError(f"{path}: is {kind}, a regular file is wanted")
    for path in of(folder):
        if path.exists() and not path.is_dir():
            raise UsageError(f"{path}: is a file, a folder is wanted")
    beside = [path for path in _further(args, "also_written") if path.parent.is_dir()]
    lengthened = [*of(numbered), *_further(args, "appended")]
    for path in [*of(written), *beside, *lengthened]:
        if outputs.is_shipped(path):
            raise UsageError(f"{path}: belongs to the program; choose another file to write")
    replaced = [*of(written, written_model), *beside]
    goals = [*replaced, *lengthened]
    changed = _changed(args, of(written_model))
    inputs = [each.path for each in found if each.role in readable and each.option != changed]
    if changed and not of(written_model):
        goals.append(getattr(args, changed))
    for path in goals:
        for memory in memories:
            if _is_of_memory(path, memory):
                raise UsageError(
                    f"{path}: belongs to the fault memory {memory}; choose another file to write"
                )
    manifests = [path.parent / manifest.NAME for path in of(*readable)]
    outputs.check(goals, [*inputs, *manifests, *memories])
    _check_models(of(written_model))
    if not getattr(args, "force", False):
        check_replaced(replaced)


def check_replaced(goals: Iterable[Path]) -> None:
    """Raise UsageError if a file stands in the place of an output and is no result of a command.

    Recordings carry no mark; a manifest names those that a command made. Nothing names files to
    edit by hand, so they are never replaced.
    """
    for path in goals:
        own = not path.is_file() or not path.stat().st_size or outputs.is_own(path)
        if not own and not manifest.entry_of(path):
            raise UsageError(f"{path}: is there already; --force replaces it")


def _check_models(goals: Iterable[Path]) -> None:
    for path in goals:
        if path.suffix != ".onnx":
            raise UsageError(f"{path}: a model file ends in .onnx")


def _further(args: argparse.Namespace, fact: str) -> list[Path]:
    """Return the files that the command writes without an option of their own."""
    files = getattr(args, fact, None)
    return list(files(args)) if files else []


def _changed(args: argparse.Namespace, models: list[Path]) -> str | None:
    """Return the option ``changed_in_place`` of the command, if its file is the one to write."""
    option: str | None = getattr(args, "changed_in_place", None)
    if option is None or (models and not outputs.same(models[0], getattr(args, option))):
        return None
    return option


def named(parser: argparse.ArgumentParser, args: argparse.Namespace) -> Iterator[Named]:
    """Yield the paths that the options of the chosen command hold."""
    for action in parser._actions:  # argparse has no public list of a parser's options
        value = getattr(args, action.dest, None)
        if isinstance(action, argparse._SubParsersAction):
            yield from named(action.choices[str(value)], args)
        elif isinstance(action.type, PathRole) and value is not None:
            for path in value if isinstance(value, list) else [value]:
                yield Named(action.type, action.dest, path)


def _is_of_memory(path: Path, memory: Path) -> bool:
    """Return whether the file is one that lies beside a fault memory: its partner or lock."""
    place, own = path.resolve(), memory.resolve()
    return place.parent == own.parent and place != own and place.name.startswith(own.name)
