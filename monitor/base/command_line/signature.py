"""A function's signature is its command: names, types and defaults; its docstring holds the help.

Positional parameters are positional arguments, keyword-only ones options. A parameter whose type is
a dataclass adds the fields of that class; a parameter of type ``argparse.Namespace`` gets all that
was parsed. ``Annotated`` tells what a type cannot, in any order: a function that turns a text into
the value or adds arguments to a parser, option names, the metavar, ``REPEATED``, ``ActsOn``, and a
dict of further keywords of argparse. The docstring's line ``name : text`` is a parameter's help.

>>> def shift(log: Annotated[str, "LOG"], *, delay_s: Annotated[float, "S"] = 0.5) -> str:
...     '''Shift a log.
...
...     log : recording to read
...     delay_s : time to add
...     '''
...     return f"{log} {delay_s}"
>>> parser = argparse.ArgumentParser()
>>> add_command(parser, shift)
>>> args = parser.parse_args(["a.log", "--delay-s", "2"])
>>> args.func(args)
'a.log 2.0'
"""

import argparse
import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from functools import partial
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, Union, cast, get_args, get_origin, get_type_hints

from monitor.base.command_line.option_kinds import ActsOn

Command = Callable[..., Any]
REPEATED: Final = ("repeated",)  # an option that is given once for each of its values
_HELP: Final = re.compile(r"^(\w+) : (.+(?:\n +.+)*)", re.MULTILINE)
_END: Final = re.compile(r"^(\w+ : |Raises |>>> )", re.MULTILINE)


def add_command(
    parser: argparse.ArgumentParser, command: Command, examples: str = "", **facts: Any
) -> None:
    """Let a parser take the parameters of a command, which ``args.func`` then calls.

    examples : shown at the end of the help
    facts : further defaults of the parser, such as ``also_written``
    """
    text = inspect.getdoc(command) or ""
    end = _END.search(text)
    parser.description = text[: end.start() if end else None].strip().replace("\n\n", "\n")
    parser.epilog = examples
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_options(parser, command)
    parser.set_defaults(func=partial(called, command), **facts)


def add_options(parser: argparse.ArgumentParser, command: Command) -> None:
    """Add the parameters of a function, or the fields of a dataclass, to a parser."""
    helps = _helps(command)
    for parameter, hint in _parameters(command):
        kind, several, told = _unwrapped(hint)
        if is_dataclass(kind) and not told:
            add_options(parser, cast("Command", kind))
        elif kind is argparse.Namespace:
            for adds in told:
                adds(parser)
        else:
            text = helps.get(parameter.name, "")
            words, keywords = _argument(parameter, kind, several, told)
            help_text = {"help": _help(text, parameter.default)}
            action = parser.add_argument(*words, **help_text | keywords)
            for each in told:
                if isinstance(each, ActsOn):
                    each.mark(action)


def called(command: Command, args: argparse.Namespace) -> Any:
    """Call a command with the values of its parameters."""
    values = {}
    for parameter, hint in _parameters(command):
        kind, _, told = _unwrapped(hint)
        if is_dataclass(kind) and not told:
            values[parameter.name] = called(cast("Command", kind), args)
        else:
            whole = kind is argparse.Namespace
            values[parameter.name] = args if whole else getattr(args, parameter.name)
    return command(**values)


def _parameters(command: Command) -> Iterator[tuple[inspect.Parameter, Any]]:
    """Yield parameters with their types; those of a class come before those of its bases."""
    hints = get_type_hints(command, include_extras=True)
    classes = command.__mro__ if isinstance(command, type) else ()
    given = [vars(each).get("__annotations__", {}) for each in classes]

    def place(parameter: inspect.Parameter) -> int:
        return next((i for i, names in enumerate(given) if parameter.name in names), 0)

    for parameter in sorted(inspect.signature(command).parameters.values(), key=place):
        yield parameter, hints[parameter.name]


def _helps(command: Command) -> dict[str, str]:
    """Return the help of each parameter; a class has that of its bases, too."""
    classes = reversed(command.__mro__) if isinstance(command, type) else [command]
    texts = [inspect.cleandoc(each.__doc__ or "") for each in classes]
    return {name: " ".join(text.split()) for each in texts for name, text in _HELP.findall(each)}


def _unwrapped(hint: Any) -> tuple[Any, bool, tuple[Any, ...]]:
    """Return the type of one value, whether there are several, and what ``Annotated`` tells."""
    if get_origin(hint) is Annotated:
        kind, several, told = _unwrapped(hint.__origin__)
        return kind, several, (*told, *hint.__metadata__)
    if get_origin(hint) in (Union, UnionType):
        return _unwrapped(next(each for each in get_args(hint) if each is not NoneType))
    if get_origin(hint) is Sequence:
        kind, _, told = _unwrapped(get_args(hint)[0])
        return kind, True, told
    return hint, False, ()


def _argument(
    parameter: inspect.Parameter, kind: Any, several: bool, told: tuple[Any, ...]
) -> tuple[list[str], dict[str, Any]]:
    """Return names and keywords of argparse for a parameter."""
    words = [each for each in told if isinstance(each, str)]
    names = [word for word in words if word.startswith("-")]
    is_option = parameter.kind is inspect.Parameter.KEYWORD_ONLY
    needed, default = parameter.default is inspect.Parameter.empty, parameter.default
    keywords: dict[str, Any] = {"dest": parameter.name} if is_option else {}
    if is_option and needed:
        keywords["required"] = True
    if kind is bool:
        keywords["action"] = "store_true"
    else:
        is_choice = get_origin(kind) is Literal
        turns = [each for each in told if callable(each)] or ([] if is_choice else [kind])
        metavars = [word for word in words if word not in names]
        keywords |= {"choices": get_args(kind)} if is_choice else {}
        keywords |= {"type": turns[0]} if turns else {}
        keywords |= {"metavar": metavars[0]} if metavars else {}
    if REPEATED in told:
        keywords["action"] = "append"
    elif several:
        keywords["nargs"] = "+" if is_option or needed else "*"
    elif not (is_option or needed):
        keywords["nargs"] = "?"
    if not needed and kind is not bool:
        keywords["default"] = list(default) if several and default is not None else default
    for each in told:
        keywords |= each if isinstance(each, dict) else {}
    flags = names or [f"--{parameter.name.replace('_', '-')}"]
    return flags if is_option else [parameter.name], keywords


def _help(text: str, default: Any) -> str:
    """Return the help, which says the default, unless the text says what happens without one."""
    text = text.replace("%", "%%")
    untold = default in (inspect.Parameter.empty, None, (), "") or isinstance(default, bool)
    if untold or "(default" in text:
        return text
    values = default if isinstance(default, tuple) else (default,)
    shown = " ".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values)
    return f"{text} (default: {shown})"
