"""Scenario files: faults with severity and time span, and the expected codes.

``docs/guides/inject.md`` lists the keys with units and defaults.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from monitor.base.errors import ConfigError, UsageError
from monitor.base.files.inputs import read_toml
from monitor.inject.injection import Injection
from monitor.memory.codes import CODES

NO_CODE: Final = "none"
MOST_DRIVES: Final = 100
_CODES: Final = sorted({code for group in CODES.values() for code in group})


@dataclass(frozen=True, slots=True)
class Expectation:
    """The expected code of one drive."""

    code: str  # or NO_CODE
    drive: int  # from 1
    state: str = ""  # "pending", "confirmed", or "" for either
    within_s: float = math.inf  # after the drive's first fault begins
    judged: bool = True  # with NO_CODE: the response test must have completed

    def __str__(self) -> str:
        if self.code == NO_CODE:
            return "no code" + (", judged" if self.judged else "")
        state = f" {self.state}" if self.state else ""
        within = f" within {self.within_s:g} s" if math.isfinite(self.within_s) else ""
        return f"{self.code}{state}{within}"


@dataclass(frozen=True, slots=True)
class Scenario:
    """Faults and expectations of one test."""

    faults: tuple[Injection, ...]
    expectations: tuple[Expectation, ...] = ()
    title: str = ""
    seed: int = 0
    n_drives: int = 1
    keep_counters: bool = False

    def faults_of(self, drive: int) -> tuple[Injection, ...]:
        """Return the faults of a drive; drives count from 1."""
        return tuple(f for f in self.faults if not f.drives or drive in f.drives)

    def seed_of(self, drive: int) -> int:
        """Return the seed of a drive's random faults."""
        return self.seed + drive - 1

    def begin_s(self, drive: int) -> float:
        """Return the start in s of the drive's first fault, 0 without a fault."""
        return min((fault.start_s for fault in self.faults_of(drive)), default=0.0)


def parse_fault(text: str) -> Injection:
    """Return the fault of ``NAME[=SEVERITY][@START[-END]]``, times in s.

    Raises UsageError if the text has another form.

    >>> parse_fault("delay_symmetric=0.8@60-90").end_s
    90.0
    """
    name, at, span = text.partition("@")
    name, equals, severity = name.partition("=")
    start, dash, end = span.partition("-")
    try:
        return Injection.of(
            name,
            float(severity) if equals else None,
            start_s=float(start) if at else 0.0,
            end_s=float(end) if dash else math.inf,
        )
    except ValueError:
        raise UsageError(
            f"--fault {text}: wanted NAME[=SEVERITY][@START[-END]] with numbers, times in s"
        ) from None


def load(path: Path) -> Scenario:
    """Return the scenario of a TOML file.

    Raises ConfigError with file and key if a key is unknown or missing, or a value impossible.
    """
    return _ScenarioReader(path).scenario(read_toml(path, "the scenario", ConfigError))


class _ScenarioReader:
    """Checks and converts the parsed TOML of one file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def scenario(self, raw: Mapping[str, Any]) -> Scenario:
        self._known(raw, "", ("title", "seed", "drives", "keep_counters", "fault", "expect"))
        n_drives = self._whole(raw, "", "drives", 1)
        if not 1 <= n_drives <= MOST_DRIVES:
            raise self._error("", "drives", n_drives, f"1 to {MOST_DRIVES}")
        faults = [
            self._fault(table, f"[[fault]] {number}: ", n_drives)
            for number, table in enumerate(self._tables(raw, "fault"), 1)
        ]
        expectations = [
            self._expectation(table, f"[[expect]] {number}: ", n_drives)
            for number, table in enumerate(self._tables(raw, "expect"), 1)
        ]
        self._check_together(expectations)
        return Scenario(
            faults=tuple(faults),
            expectations=tuple(expectations),
            title=self._text(raw, "", "title", ""),
            seed=self._whole(raw, "", "seed", 0),
            n_drives=n_drives,
            keep_counters=self._truth(raw, "", "keep_counters", False),
        )

    def _fault(self, table: Mapping[str, Any], where: str, n_drives: int) -> Injection:
        keys = ("name", "severity", "start_s", "end_s", "drives", "messages", "can_id")
        self._known(table, where, keys)
        drives = self._list(table, where, "drives", int)
        if any(not 1 <= each <= n_drives for each in drives):
            raise self._error(where, "drives", list(drives), f"numbers from 1 to {n_drives}")
        try:
            return Injection.of(
                self._text(table, where, "name"),
                self._number(table, where, "severity", None),
                start_s=self._number(table, where, "start_s", 0.0),
                end_s=self._number(table, where, "end_s", math.inf),
                messages=self._list(table, where, "messages", str),
                can_id=self._whole(table, where, "can_id", 0),
                drives=drives,
            )
        except UsageError as error:
            raise ConfigError(f"{self.path}: {where}{error}") from None

    def _expectation(self, table: Mapping[str, Any], where: str, n_drives: int) -> Expectation:
        self._known(table, where, ("code", "state", "within_s", "drive", "judged"))
        code = self._text(table, where, "code")
        state = self._text(table, where, "state", "")
        drive = self._whole(table, where, "drive", n_drives)
        within_s = self._number(table, where, "within_s", math.inf)
        assert within_s is not None
        if code not in (*_CODES, NO_CODE):
            raise self._error(where, "code", code, f"{', '.join(_CODES)} or {NO_CODE}")
        if state not in ("", "pending", "confirmed"):
            raise self._error(where, "state", state, "pending or confirmed")
        if not 1 <= drive <= n_drives:
            raise self._error(where, "drive", drive, f"1 to {n_drives}")
        if not within_s > 0.0:
            raise self._error(where, "within_s", within_s, "above 0")
        for key in ("state", "within_s") if code == NO_CODE else ("judged",):
            if key in table:
                raise ConfigError(f"{self.path}: {where}{key} says nothing beside code = {code!r}")
        return Expectation(code, drive, state, within_s, self._truth(table, where, "judged", True))

    def _check_together(self, expectations: Sequence[Expectation]) -> None:
        for drive in {each.drive for each in expectations}:
            codes = [each.code for each in expectations if each.drive == drive]
            if len(set(codes)) < len(codes) or (NO_CODE in codes and len(codes) > 1):
                raise ConfigError(
                    f"{self.path}: [[expect]] of drive {drive} contradict each other or repeat"
                )

    def _known(self, table: Mapping[str, Any], where: str, keys: Sequence[str]) -> None:
        for key in table:
            if key not in keys:
                raise ConfigError(
                    f"{self.path}: {where}key {key!r} is unknown; there are {', '.join(keys)}"
                )

    def _error(self, where: str, key: str, came: object, wanted: str) -> ConfigError:
        return ConfigError(f"{self.path}: {where}{key} = {came!r}, wanted {wanted}")

    def _tables(self, raw: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
        value = raw.get(key, [])
        if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
            raise ConfigError(f"{self.path}: {key} is written as [[{key}]]")
        return value

    def _text(
        self, table: Mapping[str, Any], where: str, key: str, default: str | None = None
    ) -> str:
        value = table.get(key, default)
        if value is None:
            raise ConfigError(f"{self.path}: {where}{key} is missing")
        if not isinstance(value, str):
            raise self._error(where, key, value, "a text")
        return value

    def _number(
        self, table: Mapping[str, Any], where: str, key: str, default: float | None
    ) -> float | None:
        value = table.get(key, default)
        if key not in table:
            return default
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise self._error(where, key, value, "a number")
        return float(value)

    def _whole(self, table: Mapping[str, Any], where: str, key: str, default: int) -> int:
        value = table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self._error(where, key, value, "a whole number")
        return value

    def _truth(self, table: Mapping[str, Any], where: str, key: str, default: bool) -> bool:
        value = table.get(key, default)
        if not isinstance(value, bool):
            raise self._error(where, key, value, "true or false")
        return value

    def _list(self, table: Mapping[str, Any], where: str, key: str, kind: type) -> tuple[Any, ...]:
        value = table.get(key, [])
        if (
            not isinstance(value, list)
            or any(isinstance(each, bool) or not isinstance(each, kind) for each in value)
            or (key in table and not value)
        ):
            raise self._error(
                where, key, value, "a list of " + ("names" if kind is str else "whole numbers")
            )
        return tuple(value)
