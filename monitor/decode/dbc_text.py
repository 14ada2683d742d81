"""Databases (DBC) with mistakes: their text without statements that no reader understands.

Public databases break the format in few ways: 29-bit identifiers without their mark, values of
signals that do not exist, names that begin with a digit, a quote too many. The first is mended;
anything else is left out and listed, and the rest is read.
"""

import re
from collections.abc import Callable
from typing import Final, TypeVar

T = TypeVar("T")

MOST: Final = 60  # statements that may be left out; with more the file is no DBC
MOST_CHARACTERS: Final = 20_000_000  # parsed in all, about a minute
_STANDARD: Final = 0x7FF  # highest identifier of 11 bits
_LONGEST: Final = 0x1FFFFFFF  # highest identifier of 29 bits
_MARK: Final = 1 << 31  # set in a DBC on identifiers of 29 bits
_KEYWORD: Final = re.compile(
    r"[ \t]*(?:(?:VERSION|NS_|BS_|BU_)\b|(?:BO_TX_BU_|BO_|SG_MUL_VAL_|SG_|VAL_TABLE_|VAL_|CM_|"
    r"BA_DEF_DEF_REL_|BA_DEF_DEF_|BA_DEF_REL_|BA_DEF_|BA_REL_|BA_|EV_|ENVVAR_DATA_|SIG_GROUP_|SIG_VALTYPE_|"
    r"SIGTYPE_VALTYPE_)\s+\S)"
)
_NUMBERED: Final = re.compile(  # statements that name a message by its identifier
    r"^([ \t]*(?:BO_TX_BU_|BO_|SG_MUL_VAL_|VAL_|SIG_GROUP_|SIG_VALTYPE_|CM_\s+(?:BO_|SG_)|"
    r'BA_\s+"[^"]*"\s+(?:BO_|SG_))\s+)(\d+)',
    re.MULTILINE,
)
_MESSAGE: Final = re.compile(r"[ \t]*BO_\s+(\d+)\s+(\w+)")
_SIGNAL: Final = re.compile(r"[ \t]*SG_\s+(\w+)")
_VALUES: Final = re.compile(r"[ \t]*VAL_\s+(\d+)\s+(\w+)")
_LINE: Final = re.compile(r"at line (\d+)")
_IN_MESSAGE: Final = re.compile(r"in message (\w+)")
_OF_MESSAGE: Final = re.compile(r"[ \t]*(BO_|SG_)\s")
_ABOUT: Final = re.compile(r"[ \t]*(CM_|BA_|BA_DEF_|VAL_|BO_TX_BU_|SIG_VALTYPE_|SG_MUL_VAL_)\s+\S")


def mended(text: str) -> tuple[str, list[str]]:
    """Return a text with identifiers marked and values of unknown signals left out; the changes."""
    text, marked = _marked(text)
    kept, lost = [], []
    known = _signals(text)
    is_impossible = False
    for statement in _statements(text):
        if message := _MESSAGE.match(statement):
            is_impossible = int(message[1]) & ~_MARK > _LONGEST
            if is_impossible:
                lost.append(f"message {message[2]}: impossible identifier {message[1]}")
        if is_impossible and _OF_MESSAGE.match(statement):
            continue
        values = _VALUES.match(statement)
        if _ABOUT.match(statement) and not statement.rstrip().endswith(";"):
            lost.append(f"no end: {_short(statement)}")
        elif values and (int(values[1]), values[2]) not in known:
            lost.append(f"values of the unknown signal {values[2]} of message {values[1]}")
        else:
            kept.append(statement)
    return "".join(_sorted(kept)), [*marked, *lost]


def read(text: str, parse: Callable[[str], T]) -> tuple[T, tuple[str, ...]]:
    """Return the result of ``parse`` on a text, and the changes and omissions.

    Statements at which the parser fails are left out one by one. Raises what ``parse`` raises if
    it names no line, or if too much would be left out.
    """
    text, notes = mended(text)
    for _ in range(min(MOST, max(MOST_CHARACTERS // max(len(text), 1), 1))):
        try:
            return parse(text), tuple(notes)
        except Exception as error:  # cantools raises its parsers' own errors
            text, note = _without(text, str(error))
            if not note:
                raise
            notes.append(note)
            text, _ = mended(text)  # without the values of signals that went
    return parse(text), tuple(notes)


def _marked(text: str) -> tuple[str, list[str]]:
    """Mark identifiers of more than 11 bits as 29-bit ones; return the messages, too."""
    notes = []
    for number, name in _MESSAGE.findall(text):
        if _STANDARD < int(number) <= _LONGEST:
            notes.append(f"message {name}: identifier 0x{int(number):X} read as one of 29 bits")

    def mark(found: re.Match[str]) -> str:
        number = int(found[2])
        if _STANDARD < number <= _LONGEST:
            number |= _MARK
        return f"{found[1]}{number}"

    return _NUMBERED.sub(mark, text), notes


def _signals(text: str) -> set[tuple[int, str]]:
    """Return identifier and name of every signal."""
    found: set[tuple[int, str]] = set()
    number = -1
    for line in text.splitlines():
        if message := _MESSAGE.match(line):
            number = int(message[1])
        elif (signal := _SIGNAL.match(line)) and number & ~_MARK <= _LONGEST:
            found.add((number, signal[1]))
    return found


def _statements(text: str) -> list[str]:
    """Return the statements of a text, each with its lines up to the next keyword."""
    found: list[str] = []
    is_quoted = False
    for line in text.splitlines(keepends=True):
        if found and (is_quoted or not _KEYWORD.match(line)):
            found[-1] += line
        else:
            found.append(line)
            is_quoted = False
        if line.count('"') % 2:
            is_quoted = not is_quoted and not line.rstrip().endswith(";")
    return found


def _sorted(statements: list[str]) -> list[str]:
    """Return the statements with each message before the statements about it."""
    told = [i for i, each in enumerate(statements) if _ABOUT.match(each)]
    first = told[0] if told else len(statements)
    late = [i for i in range(first, len(statements)) if _OF_MESSAGE.match(statements[i])]
    if not late:
        return statements
    moved = set(late)
    rest = [each for i, each in enumerate(statements) if i >= first and i not in moved]
    return [*statements[:first], *(statements[i] for i in late), *rest]


def _without(text: str, error: str) -> tuple[str, str]:
    """Return the text without the statement that an error is about, and that statement.

    The words are "" if there is no such statement. A message goes with its signals.
    """
    statements = _statements(text)
    place = _place(statements, error)
    if place is None or _KEYWORD.match(statements[place]) is None:
        return text, ""
    stop = place + 1
    if statements[place].lstrip().startswith("BO_ "):
        while stop < len(statements) and statements[stop].lstrip().startswith("SG_ "):
            stop += 1
    rest = [*statements[:place], *statements[stop:]]
    return "".join(rest), _short(statements[place])


def _short(statement: str) -> str:
    return " ".join(statement.split())[:60]


def _place(statements: list[str], error: str) -> int | None:
    """Return the number of the statement that an error names by its line or its message."""
    if line := _LINE.search(error):
        begin = 1
        for place, statement in enumerate(statements):
            begin += statement.count("\n")
            if int(line[1]) < begin:
                return place
        return len(statements) - 1
    if message := _IN_MESSAGE.search(error):
        for place, statement in enumerate(statements):
            found = _MESSAGE.match(statement)
            if found and found[2] == message[1]:
                return place
    return None
