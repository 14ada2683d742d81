"""The frame of a command: options, files, exit codes. ``o2mon`` and ``o2train`` share it.

Exit codes: what the command returns (0, 1, 3), 2 for an error that the user can correct, 4 for an
internal error, 130 interrupted, 141 if the reader of the output is gone. Python's own 1 would mean
a sensor fault, so it never gets out. The last line on stderr is the error.
"""

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any, Final, NoReturn, TextIO

from monitor.base.command_line import option_kinds, option_paths
from monitor.base.command_line.signature import add_command
from monitor.base.errors import O2Error

USAGE_ERROR: Final = 2
INTERNAL_ERROR: Final = 4
INTERRUPTED: Final = 130
BROKEN_PIPE: Final = 141
_LONGEST: Final = 2000  # characters of an error
_OWN: Final = ("monitor", "training", "dbc")


class Parser(argparse.ArgumentParser):
    """The parser of a program or subcommand: an impossible option is one line, not the usage."""

    def error(self, message: str) -> NoReturn:  # noqa: D102
        self.exit(USAGE_ERROR, f"{self.prog}: {message}; {self.prog} --help tells more\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # noqa: D102
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            known = [option for action in self._actions for option in action.option_strings]
            alike = get_close_matches(unknown[0], known, 1)
            advice = f"; did you mean {alike[0]}?" if alike else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{advice}")
        return found, unknown


def parser(
    name: str, text: str, package: str, helps: Mapping[str, str], arguments: Sequence[str] | None
) -> argparse.ArgumentParser:
    """Return the parser of a program; only the command of the arguments has its options.

    text : description of the program
    package : has a module for each command, with its ``run`` and ``EXAMPLES``, or with ``add``,
        which takes the command's parser; that of export-c is ``export_c``
    helps : commands with one line of help each
    arguments : with None every command has its options
    """
    from monitor import __version__  # noqa: PLC0415 - the version stands above this room

    program = Parser(prog=name, description=text)
    program.add_argument("--version", action="version", version=f"{name} {__version__}")
    commands = program.add_subparsers(
        required=True, metavar="command", dest="command", parser_class=Parser
    )
    chosen = next((word for word in arguments or () if not word.startswith("-")), None)
    for command, line in helps.items():
        added = commands.add_parser(command, help=line)
        if arguments is None or command == chosen:
            module = import_module(f"{package}.{command.replace('-', '_')}")
            getattr(module, "add", partial(add_module, module))(added)
            option_paths.add_force(added)
    return program


def add_module(module: ModuleType, parser: argparse.ArgumentParser) -> None:
    """Make a parser that of a module's ``run``, with what the check of its files must know."""
    facts = {name: getattr(module, name, None) for name in option_paths.FACTS}
    add_command(parser, module.run, module.EXAMPLES, **facts)


def run(
    name: str,
    parser: Callable[[Sequence[str]], argparse.ArgumentParser],
    argv: Sequence[str] | None,
    *,
    kinds: str = "",
    extra: str | None = None,
) -> int:
    """Parse the arguments, check the files of the options, run the command; return its exit code.

    parser : makes the parser that the arguments need
    kinds : module whose ``kinds_of`` tells what a recording may be, imported if an option asks
    extra : optional dependencies that the user is told to install if a package is missing
    """
    for stream in (sys.stdout, sys.stderr):  # a name in another encoding must not end a command
        if hasattr(stream, "reconfigure"):
            with suppress(OSError):
                stream.reconfigure(errors="backslashreplace")
    try:
        words = sys.argv[1:] if argv is None else argv
        return _run(parser(words), words, kinds)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        _to_nowhere(sys.stdout)
        return BROKEN_PIPE
    except Exception as error:
        text = _users_part(error, extra)
        if text is None and os.environ.get("O2_TRACEBACK"):
            raise
        _to_nowhere_if_full(sys.stdout)
        line = text or f"internal error: {type(error).__name__}: {' '.join(str(error).split())}"
        with suppress(OSError):
            print(f"{name}: {_one_line(line)}", file=sys.stderr, flush=True)
        return USAGE_ERROR if text else INTERNAL_ERROR


def _run(parser: argparse.ArgumentParser, argv: Sequence[str], kinds: str) -> int:
    try:
        args = parser.parse_args(argv)
    except SystemExit:  # after --help, or an impossible option
        _flush(sys.stdout)
        raise
    option_paths.check(parser, args)
    if kinds:
        option_kinds.check(parser, args, lambda path: import_module(kinds).kinds_of(path))
    code = int(args.func(args))
    _flush(sys.stdout)
    return code


def _users_part(error: Exception, extra: str | None) -> str | None:
    """Return the message for an error that the user can correct, None for a bug."""
    if isinstance(error, O2Error):
        return str(error)
    if extra and isinstance(error, ModuleNotFoundError):
        package = (error.name or "").split(".")[0]
        if package not in _OWN:
            return f"{package} is not installed: pip install '.[{extra}]' in the project's folder"
    if isinstance(error, OSError):
        return f"{error.filename or 'output'}: {error.strerror or error}"
    if isinstance(error, MemoryError):
        return "the memory of this machine does not suffice for the input"
    return None


def _one_line(text: str) -> str:
    """Return an error as one line of bounded length: a name in a file may hold anything."""
    text = text[: _LONGEST + 1].replace("\N{NO-BREAK SPACE}", " ")
    text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} …"


def _flush(stream: TextIO | None) -> None:
    """Write the text that a stream still holds: Python's own end would turn an error into 120."""
    if stream is not None:
        stream.flush()


def _to_nowhere(stream: TextIO | None) -> None:
    """Let a stream whose reader is gone end in nothing, so that Python's end has no error."""
    if stream is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _to_nowhere_if_full(stream: TextIO | None) -> None:
    """Give up the text that a stream cannot write, on a full disk for instance."""
    try:
        _flush(stream)
    except OSError:
        _to_nowhere(stream)
