"""Settings files: a ``default.toml`` holds each value beside its bounds, the user's file values.

A setting is a value, or a table with ``value`` and its bounds. A number without bounds lies above 0
and is at most 1e6.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, TypeVar

from monitor.base.errors import ConfigError
from monitor.base.files.inputs import read_toml

_MOST: Final = 1e6  # 11 days, or so many samples
_Kind = TypeVar("_Kind")


@dataclass(frozen=True, slots=True)
class BoundedSetting:
    """A shipped value with its bounds."""

    value: Any
    min: float | None = None  # allowed itself; None: above 0
    max: float = _MOST  # allowed itself
    below: str = ""  # key of the same section
    beyond: tuple[str, ...] = ()  # keys, above all of which an element of the list must lie
    one_of: tuple[str, ...] = ()

    @classmethod
    def of(cls, entry: Any) -> "BoundedSetting":
        """Return a setting of the file."""
        is_table = isinstance(entry, dict) and "value" in entry
        return cls(**entry) if is_table else cls(entry)

    def misfit(self, value: Any) -> str:
        """Return in words what is wanted where a value is of another type or size, else nothing.

        >>> BoundedSetting(50, min=10).misfit(9)
        '9, wanted at least 10 and at most 1e+06'
        """
        kind: type = type(self.value)
        name, elements, fits = kind.__name__, [value], True
        if kind is list:
            kind = str if all(isinstance(each, str) for each in self.value) else float
            name = f"list of {'names' if kind is str else 'numbers'}"
            elements = value if isinstance(value, list) else [None]
            fits = bool(value) or kind is str
        if not fits or not all(_is(kind, each) for each in elements):
            return f"{value!r}, wanted {name}"
        for number in [] if kind is str else elements:
            above = number > 0.0 if self.min is None else number >= self.min
            if not (above and number <= self.max):
                least = "above 0" if self.min is None else f"at least {self.min:g}"
                return f"{number}, wanted {least} and at most {self.max:g}"
        return ""

    def contradiction(self, value: Any, section: Mapping[str, Any]) -> str:
        """Return in words what is wanted where a value contradicts others, else nothing.

        section : values by key
        """
        if self.one_of and value not in self.one_of:
            return f"{value!r}, wanted one of {list(self.one_of)}"
        if self.below and value >= section[self.below]:
            return f"{value}, wanted below {self.below} = {section[self.below]}"
        limit = max((section[key] for key in self.beyond), default=None)
        if limit is not None and max(value) <= limit:
            return f"{value}, wanted one above the limit {limit} s"
        return ""


class ShippedSettings:
    """The shipped settings of a package, by section and key."""

    def __init__(self, package: str) -> None:
        tree = tomllib.loads(files(package).joinpath("default.toml").read_text(encoding="utf-8"))
        self.sections = {
            name: {key: BoundedSetting.of(entry) for key, entry in entries.items()}
            for name, entries in tree.items()
        }

    def values(self) -> dict[str, dict[str, Any]]:
        """Return the shipped values."""
        return {
            name: {key: setting.value for key, setting in settings.items()}
            for name, settings in self.sections.items()
        }

    def changed(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the values with those of a file, which may leave out sections and keys.

        Raises ConfigError with file and key if a key is unknown or a value is of the wrong type or
        impossible.
        """
        values = self.values()
        for name, own in read_toml(path, "the settings", ConfigError).items():
            if name not in values:
                raise ConfigError(f"{path}: section [{name}] is unknown; there are {list(values)}")
            if not isinstance(own, dict):
                raise ConfigError(f"{path}: {name} is a section, {own!r} came")
            settings = self.sections[name]
            for key, value in own.items():
                if key not in settings:
                    there = list(settings)
                    raise ConfigError(f"{path}: [{name}] {key} is unknown; there are {there}")
                if wanted := settings[key].misfit(value):
                    raise ConfigError(f"{path}: [{name}] {key} = {wanted}")
            values[name] |= own
        for name, settings in self.sections.items():
            for key, setting in settings.items():
                if wanted := setting.contradiction(values[name][key], values[name]):
                    raise ConfigError(f"{path}: [{name}] {key} = {wanted}")
        return values


def built(kind: type[_Kind], values: Mapping[str, Any]) -> _Kind:
    """Return values as a dataclass whose fields are sections or settings; a list becomes a tuple.

    Raises TypeError if a section or key is too few or too many.
    """
    kinds = {field.name: field.type for field in fields(kind)}  # type: ignore[arg-type]

    def value_of(name: str, value: Any) -> Any:
        section = kinds.get(name)
        if isinstance(section, type) and is_dataclass(section):
            return built(section, value)
        return tuple(value) if isinstance(value, list) else value

    return kind(**{name: value_of(name, value) for name, value in values.items()})


def _is(wanted: type, value: Any) -> bool:
    """Return whether a value is of a type; an int is a float too, a bool is no number."""
    kinds = int | float if wanted is float else wanted
    return isinstance(value, kinds) and not isinstance(value, bool)
