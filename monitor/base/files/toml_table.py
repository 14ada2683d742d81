"""A table of a parsed TOML file whose keys and values are checked as they are taken."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar, get_args, get_origin, get_type_hints

from monitor.base.errors import O2Error
from monitor.base.files.inputs import as_number, in_words, read_toml

T = TypeVar("T")
_NEEDED: Final = object()  # the default of a key that has none
_WANTED: Final = {
    str: ("a text is", "texts are"),
    float: ("a number is", "numbers are"),
    int: ("a whole number is", "whole numbers are"),
    bool: ("true or false is", ""),
}


class TomlTable:
    """One table of a file.

    error : raised with file, table, key, what came and what was wanted
    where : the table's name in messages, "" for the file itself
    """

    def __init__(
        self, tree: Mapping[str, Any], path: Path, error: type[O2Error], where: str = ""
    ) -> None:
        self.tree, self.path, self.where, self._error = tree, path, where, error

    @classmethod
    def of_file(cls, path: Path, what: str, error: type[O2Error]) -> "TomlTable":
        """Return the table of a whole file; errors as of ``read_toml``."""
        return cls(read_toml(path, what, error), path, error)

    def __contains__(self, key: str) -> bool:
        return key in self.tree

    def __iter__(self) -> Iterator[str]:
        return iter(self.tree)

    def only(self, known: Iterable[str]) -> "TomlTable":
        """Return the table; raises the error for a key that is not known."""
        known = sorted(known)
        for key in self.tree:
            if key not in known:
                raise self.fault(f"has the unknown key {key!r}, known are {', '.join(known)}")
        return self

    def fault(self, problem: str) -> O2Error:
        """Return the error of this table."""
        return self._error(f"{self.path}: {self.where}{' ' if self.where else ''}{problem}")

    def unwanted(self, key: str, wanted: str) -> O2Error:
        """Return the error of a key's value; wanted : with its verb."""
        return self.fault(f"{key} is {in_words(self.tree[key])}, {wanted} wanted")

    def value(self, key: str, kind: type, default: Any = _NEEDED) -> Any:
        """Return a text, a finite number, a whole number or a truth, or the default."""
        if key not in self.tree:
            if default is _NEEDED:
                raise self.fault(f"{key} is missing, {_WANTED[kind][0]} wanted")
            return default
        value = _of_kind(self.tree[key], kind)
        if value is None:
            raise self.unwanted(key, _WANTED[kind][0])
        return value

    def values(self, key: str, kind: type, *, or_one: bool = False) -> tuple[Any, ...]:
        """Return a list of values of a kind, empty if there is none.

        or_one : a value may stand for a list of it
        """
        given = self.tree.get(key, [])
        listed = given if isinstance(given, list) or not or_one else [given]
        values = tuple(_of_kind(each, kind) for each in listed) if isinstance(listed, list) else ()
        if not isinstance(listed, list) or None in values:
            raise self.unwanted(key, _WANTED[kind][1])
        return values

    def record(self, base: T, keys: Mapping[str, str] | None = None) -> T:
        """Return a dataclass with this table's values in the fields that it names.

        keys : of fields that have another name than their key
        """
        hints, renamed = get_type_hints(type(base)), keys or {}
        names = {renamed.get(name, name): name for name in hints}
        self.only(names)
        values = {}
        for key in self:
            kind, *_ = get_args(hints[names[key]]) or (hints[names[key]],)  # X of X | None
            is_list = get_origin(hints[names[key]]) is tuple
            values[names[key]] = (
                self.values(key, kind, or_one=True) if is_list else self.value(key, kind)
            )
        return replace(base, **values)  # type: ignore[type-var]

    def table(self, key: str, where: str | None = None) -> "TomlTable":
        """Return the table under a key, empty if there is none."""
        tree = self.tree.get(key, {})
        if not isinstance(tree, dict):
            raise self.unwanted(key, "a table is")
        name = f"[{self.where.strip('[]')}.{key}]" if self.where else f"[{key}]"
        return TomlTable(tree, self.path, self._error, where or name)

    def tables(self, key: str) -> list["TomlTable"]:
        """Return the tables of a list of them."""
        trees = self.tree.get(key, [])
        if not isinstance(trees, list) or not all(isinstance(each, dict) for each in trees):
            raise self.fault(f"{key} is written as [[{key}]]")
        return [
            TomlTable(tree, self.path, self._error, f"[[{key}]] {number}:")
            for number, tree in enumerate(trees, 1)
        ]


def _of_kind(value: Any, kind: type) -> Any:
    """Return the value as one of the kind, None if it is another's."""
    if kind is float:
        return as_number(value)
    return value if type(value) is kind else None
